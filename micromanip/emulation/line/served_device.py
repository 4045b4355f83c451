"""What devices have in common whose lines compiled code serves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from micromanip.emulation.amplifier import Amplifier
from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.messages import MessageFigures
from micromanip.emulation.upkeep import Upkeep
from micromanip.testbus.event_loop import EventLoop

from .device_line import DeviceLine, report_of

PAUSE_NS = 50_000_000
"""Who has said nothing for so long begins anew."""
_PHASE_NS = 30_000
"""So old is the plant's state when it is asked for: a frame that comes a little early still finds a new one."""


class ServedDevice:
    """One whose lines compiled code serves while nothing is amiss; what is rare, and every fault, Python."""

    def __init__(
        self, keys: Any, loop: EventLoop, cell: EmulatedCell, amplifier: Amplifier | None, served_ns: int
    ) -> None:
        """`keys` are the driver's; while frames come, it has a turn each `served_ns`."""
        self._keys, self._loop, self._cell, self._amplifier = keys, loop, cell, amplifier
        self.figures = MessageFigures()
        self._lines: list[DeviceLine] = []
        self._silent_until_ns = 0.0
        self._began_ns, self._heard_ns = loop.now_ns(), 0
        self._upkeep = Upkeep(loop, self._look_after, served_ns)

    def start(self, now_ns: int) -> None:
        self._began_ns = now_ns
        self._upkeep.start()

    def silence(self, message: str, for_s: float | None) -> None:  # noqa: ARG002 (it sends but one)
        self._silent_until_ns = self._loop.end_ns(for_s)

    def clear(self) -> None:
        for line in self._lines:
            line.clear()
        self._silent_until_ns = 0.0

    def close(self) -> None:
        for line in self._lines:
            line.close()

    def report(self) -> dict[str, Any]:
        self._gather()
        return report_of(self.figures, self._lines, self._loop.now_ns() - self._began_ns)

    def is_plain(self, now_ns: int) -> bool:
        """Whether a conversation is under way, and nothing is amiss."""
        return (
            now_ns - self._heard_ns < PAUSE_NS
            and now_ns >= self._silent_until_ns
            and self._cell.undisturbed
            and all(line.undisturbed for line in self._lines)
        )

    def hears(self, now_ns: int) -> None:
        """A command comes through Python."""
        if now_ns - self._heard_ns > PAUSE_NS:
            self._cell.advance_to(now_ns)
            self._cell.plant.begin(now_ns - _PHASE_NS)
        self._heard_ns = now_ns

    def count_in(self, names: Sequence[str | None], arrived: Any) -> None:
        """Let the amplifier and compiled code count what arrives in one place: records in the order of outputs."""
        for name, a in zip(names, arrived, strict=False):
            if name is not None and self._amplifier is not None:
                self._amplifier.count_in(name, a)

    def has_taken(self, d: Any) -> None:
        """Tell the amplifier what compiled code has refused and taken."""
        self._cell.plant.is_at(self._cell.plant.time_ns)
        if self._amplifier is None:
            return
        self._amplifier.refused += int(d["refused"])
        d["refused"] = 0
        if self._amplifier.follows:
            self._amplifier.has_taken(self._heard_ns)

    def _gather(self) -> None:
        """Take over what compiled code has done since the last time."""
        raise NotImplementedError

    def _look_after(self) -> None:
        """Watchdogs, amplifier and plant go on also while nobody asks."""
        raise NotImplementedError
