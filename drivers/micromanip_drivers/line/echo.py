"""What we send on a two-wire line, and hear ourselves say: taken out of what is received."""

from __future__ import annotations


class Echo:
    """Bytes that have been sent and must come back before anything else does.

    A byte that comes back as another one, or not at all, ends the comparison: what follows is taken as the device's,
    and its checksum or its layout decide.
    """

    def __init__(self) -> None:
        self._expected = b""
        self.errors = 0

    def clear(self) -> None:
        """Expect nothing."""
        self._expected = b""

    def sent(self, data: bytes) -> None:
        """So much was sent: it will come back. What has not come back of what was sent before never will."""
        self.errors += bool(self._expected)
        self._expected = data

    def without(self, data: bytes) -> bytes:
        """What of `data`, received next, is the device's own."""
        length = min(len(self._expected), len(data))
        if not length:
            return data
        if data[:length] == self._expected[:length]:
            self._expected = self._expected[length:]
            return data[length:]
        self.errors += 1
        self._expected = b""
        return data
