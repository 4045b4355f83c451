"""The device reached, in Python: at rest before anything is sent, the right one, there again at the end."""

from __future__ import annotations

import time
from collections.abc import Iterator
from socket import socket

from micromanip.driver import Answer, IdentityMismatch, LinkError
from micromanip.driver.wire import open_datagrams

from .options import UdpOptions
from .plan import Datagrams

_ANSWER_S, _LONGEST_S = 0.02, 1.0
_LARGEST = 2048


class Opening:
    """Talks to the device while the loop doesn't."""

    def __init__(self, options: UdpOptions, datagrams: Datagrams, name: str) -> None:
        self._options, self._datagrams, self._name = options, datagrams, name
        self._safe = [field.safe for field in options.send.fields.values()]

    def connected(self) -> socket:
        """A socket to the device. Raises LinkError."""
        options = self._options
        return open_datagrams(options.host, options.port, options.listen, _ANSWER_S)

    def rest_then_ask(self) -> socket:
        """A socket to the right device, at rest. Raises LinkError, IdentityMismatch.

        Nobody else sends to it: who opens it has its lock. So nothing is sent for as long as its watchdog takes.
        """
        if self._options.watchdog is not None:
            time.sleep(self._options.watchdog.still_ns * 1e-9)
        opened = self.connected()
        try:
            if self._options.identity is not None:
                self._ask_who(opened)
        except BaseException:
            opened.close()
            raise
        return opened

    def confirms_rest(self) -> bool:
        """Send the safe values, to a device that is at rest, until it answers; whether it does."""
        with self.connected() as opened:
            for count, data in enumerate(self._exchanged(opened, _LONGEST_S)):
                if count >= 2 and self._datagrams.is_answer(data):
                    return True
        return False

    def found(self, seconds: float) -> Iterator[Answer]:
        """What it says of itself, as long as it may be asked; it is not sent any output.

        Raises LinkError.
        """
        end, note = time.monotonic() + seconds, ""
        with self.connected() as opened:
            while time.monotonic() < end:
                if self._options.identity is not None:
                    _send(opened, self._datagrams.request)
                elif not self._safe:
                    _send(opened, self._datagrams.frame([], 0))
                data = _receive(opened)
                if data is None:
                    continue
                if self._datagrams.says_who(data):
                    note = "; ".join(self._datagrams.mismatches(data))
                    yield Answer(f"{self._name} identity", self._datagrams.identity(data), note)
                elif self._datagrams.is_answer(data):
                    status = self._datagrams.status(data)
                    note = f"status {status}" if status else ""
                    yield Answer(f"{self._name} receive", self._datagrams.values(data), note)
                else:
                    note = f"{len(data)} bytes, not as configured"
                    yield Answer(f"{self._name} other", {"bytes": data.hex(" ")}, note, is_value=False)

    def _ask_who(self, opened: socket) -> None:
        end, other = time.monotonic() + _LONGEST_S, 0
        while time.monotonic() < end:
            _send(opened, self._datagrams.request)
            data = _receive(opened)
            if data is None:
                continue
            if self._datagrams.says_who(data):
                if differences := self._datagrams.mismatches(data):
                    raise IdentityMismatch(f"{self._name} has {' and '.join(differences)}")
                return
            other += 1
        why = f"{other} datagrams came that are not the answer" if other else "nothing answers"
        raise LinkError(f"{self._name} does not say who it is: {why}; check power, cable, host, port and `identity`")

    def _exchanged(self, opened: socket, seconds: float) -> Iterator[bytes]:
        end, count = time.monotonic() + seconds, 0
        while time.monotonic() < end:
            _send(opened, self._datagrams.frame(self._safe, count % 256))
            data = _receive(opened)
            if data is not None:
                count += 1
                yield data


def _send(opened: socket, data: bytes) -> None:
    try:
        opened.send(data)
    except OSError:  # nobody listened to the one before, or the network is down: nothing will answer
        time.sleep(_ANSWER_S)


def _receive(opened: socket) -> bytes | None:
    try:
        return opened.recv(_LARGEST)
    except OSError:
        return None
