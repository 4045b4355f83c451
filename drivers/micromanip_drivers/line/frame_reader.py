"""Frames as they come in through a port."""

from __future__ import annotations

import time
from collections.abc import Mapping

from micromanip.driver import TransientError

from .frame_search import FrameSearch
from .port import Port


class FrameReader:
    """The frames that `search` finds in what `port` receives."""

    def __init__(self, port: Port, search: FrameSearch) -> None:
        self._port, self._search = port, search
        self._told = 0

    def forget(self) -> None:
        """What was begun will not go on."""
        self._search.clear()
        self._told = self._search.bad

    def pardon(self) -> None:
        """Say nothing of what was damaged up to now."""
        self._told = self._search.bad

    def frames(self, until_ns: int) -> list[tuple[bytes, int]]:
        """What came, each with the time of its last byte; soon after the first, and at `until_ns` at the latest.

        Also returns, without any, once something damaged came (see `complain`). Raises LinkError.
        """
        search, whole = self._search, self._port.datagrams
        frames: list[tuple[bytes, int]] = []
        while True:
            chunks = self._port.receive(until_ns)
            for data, time_ns in chunks:
                frames += search.whole(data, time_ns) if whole else search.feed(data, time_ns)
            if not chunks:
                frames = search.quiet(time.monotonic_ns())
            if frames or search.bad != self._told or time.monotonic_ns() >= until_ns:
                return frames

    def complain(self) -> None:
        """Raises TransientError if there was a damaged frame since the last call."""
        count = self._search.bad - self._told
        self._told = self._search.bad
        if count:
            raise TransientError(f"{self._port.name}: {count} damaged frame{'s' if count > 1 else ''}")

    @property
    def received(self) -> int:
        """Bytes that came through the port, up to now."""
        return self._port.counters["bytes_in"]

    def unheard(self, before: int, otherwise: str) -> str:
        """Why nothing was understood, in words; `before` is what `received` was in the beginning."""
        count = self.received - before
        if count:
            return f"sends {count} bytes, and no frame is in them: are baud rate, sync bytes, lengths and CRC right?"
        return f"{otherwise}: is it switched on, are the wires and the baud rate right?"

    @property
    def counters(self) -> Mapping[str, int]:
        """What was not understood."""
        return {"bad_frames": self._search.bad, "skipped_bytes": self._search.skipped}
