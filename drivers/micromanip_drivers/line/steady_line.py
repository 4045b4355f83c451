"""A line that compiled functions serve as long as frames follow each other, and Python where they don't."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from micromanip.driver import ConfigError, Steady

from .frame_reader import FrameReader
from .framing import Silence
from .port import Port

if TYPE_CHECKING:
    from .tables import Tables


class SteadyLine:
    """What compiled functions and Python hand over to each other; nothing where there are no such functions."""

    def __init__(self, reader: FrameReader, port: Port, silence: Silence) -> None:
        self._reader, self._port, self._silence = reader, port, silence
        self._tables: Tables | None = None
        self.unheard: set[int] = set()
        """Tasks whose outputs were sent, and nothing was heard of the device since."""
        self.frames = 0
        """Frames that compiled functions took."""
        self.more_lost = 0
        """Samples that they know to be missing, beyond one for each count that is."""

    def begin(self, make: Callable[[], Tables]) -> Steady | None:
        """Have the functions go by the tables that `make` makes; None where it raises ConfigError, for no room."""
        if not self._port.is_plain:
            return None
        try:
            tables = self._tables = make()
        except ConfigError:
            return None
        from . import exchange  # compiled: loaded only where it is going to be called

        receive, send = exchange.ENTRIES.addresses
        return Steady(receive, send, tables.record, lambda: tables.descriptor)

    def lend(self) -> None:
        """Let them go on from where Python is."""
        if self._tables is not None:
            self._tables.lend(self._reader, self._port, self._silence, self.unheard)

    def forget(self) -> None:
        """The port is about to be closed, or was opened anew."""
        if self._tables is not None:
            self._tables.forget()
        self.unheard.clear()

    @contextmanager
    def in_python(self, error: str, doing: str) -> Iterator[None]:
        """Go on from where they are, with what one of them met in `doing`, and let them go on."""
        if (tables := self._tables) is None:
            yield
            return
        self._port.counters["bytes_in"] += tables.counted("bytes_in")
        self._port.counters["bytes_out"] += tables.counted("bytes_out")
        self.frames += tables.counted("frames")
        self.more_lost += tables.counted("more_lost")
        tables.take_back(self._reader, self._port, self._silence, self.unheard)
        try:
            if (problem := tables.error(error)) is not None:
                raise self._port.gone(doing, problem) from problem
            yield
        finally:
            self.lend()
