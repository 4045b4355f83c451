"""Lines of text out of a stream of bytes."""

from __future__ import annotations

_LONGEST = 4096


class Lines:
    """Lines end in a carriage return, a line feed, or both; blank ones are none. However the bytes are cut."""

    def __init__(self) -> None:
        self._rest = b""
        self.noise = 0
        """Lines that were no printable text, or too long."""

    def clear(self) -> None:
        """Forget what is there of a line."""
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """The lines that are complete with `data`, without blanks around them."""
        *whole, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        if len(self._rest) > _LONGEST:
            self.noise += 1
            self._rest = b""
        lines = []
        for line in whole:
            text = line.strip().decode("ascii", "replace")
            if not text:
                continue
            if text.isprintable() and text.isascii():
                lines.append(text)
            else:
                self.noise += 1
        return lines
