"""Lends healthy test buses with their devices to compiled code (``serving.py``), and takes them back as they are then.

While they are lent Python has its turn each 5 ms: for the amplifiers' watchdogs and the figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.compiled_plant import fill_plant
from micromanip.emulation.poll_table import PollTable
from micromanip.rt.jit import PLAIN, prepare
from micromanip.testbus.event_loop import EventLoop, Timer
from micromanip.testbus.hub import CanHub

from .canbus import EmulatedCanBus
from .records import BUS, FAR_NS, MAX_BUSES, ODD, SERVED
from .serving import catch_up, serve
from .steady_bus import SteadyBus

_TICK_NS = 5_000_000


class SteadyBuses:
    """All test buses of one process: compiled code serves all or none, in the order in which things happen."""

    def __init__(self, loop: EventLoop, cell: EmulatedCell, buses: Sequence[SteadyBus]) -> None:
        """`buses` have their rows in one array."""
        self._loop, self._cell, self._buses = loop, cell, buses
        self._served = np.zeros(1, SERVED)
        self._rows = np.zeros(len(buses), BUS)
        fill_plant(self._served[0], cell.plant)
        self._served["buses"] = len(buses)
        for bus, row in zip(buses, self._rows, strict=True):
            bus.describe(row, cell)
        self.is_lent = False
        self._tick: Timer | None = None
        self._polled = PollTable()
        prepare(serve, catch_up)

    @classmethod
    def of(cls, loop: EventLoop, cell: EmulatedCell, devices: Iterable[Any]) -> SteadyBuses | None:
        """For those of `devices` that are on a test bus by a DBC; None where there is none, or no room for them."""
        buses = [
            SteadyBus(device, device.bus.line)
            for device in devices
            if isinstance(device, EmulatedCanBus) and isinstance(device.bus.line, CanHub)
        ]
        if PLAIN or not 0 < len(buses) <= MAX_BUSES or not all(bus.has_room for bus in buses):
            return None
        steady = cls(loop, cell, buses)
        loop.serve_by(steady.serve)
        return steady

    def serve(self, descriptors: Sequence[int], until_ns: int | None) -> int:
        """Serve as ``EventLoop.serve_by`` says, where all is well."""
        if not self._may_serve():
            return 0
        plant, d = self._cell.plant, self._served[0]
        d["time_ns"] = plant.time_ns
        d["descriptors"] = len(descriptors)
        code = serve(
            self._served,
            self._rows,
            *plant.arrays,
            self._cell.errors.record,
            self._polled.of([*descriptors, *self._clients()]),
            FAR_NS if until_ns is None else until_ns,
        )
        plant.is_at(int(d["time_ns"]))
        if code == ODD:
            self.leave()
        return int(d["rested_ns"])

    def catch_up(self, now_ns: int) -> None:
        """Work off what happened until then, and no more: for time that is not the clock's."""
        if self._may_serve():
            plant = self._cell.plant
            self._served["time_ns"] = plant.time_ns
            code = catch_up(self._served, self._rows, *plant.arrays, self._cell.errors.record, now_ns)
            plant.is_at(int(self._served[0]["time_ns"]))
            if code == ODD:
                self.leave()

    def leave(self) -> None:
        """Python goes on; does no harm twice."""
        if not self.is_lent:
            return
        self.is_lent = False
        if self._tick is not None:
            self._tick.cancel()
        self._gather()
        for bus in self._buses:
            bus.take_back()

    def _may_serve(self) -> bool:
        """Whether all is well, and lent."""
        if not self.is_lent and not self._enter():
            return False
        if not self._cell.undisturbed or any(bus.has_other_clients for bus in self._buses):
            self.leave()
        return self.is_lent

    def _enter(self) -> bool:
        now_ns = self._loop.now_ns()
        if not self._cell.undisturbed or not all(bus.is_plain(now_ns) for bus in self._buses):
            return False
        for bus in self._buses:
            bus.lend(now_ns)
        self.is_lent = True
        self._tick = self._loop.call_at(now_ns + _TICK_NS, self._look_after)
        return True

    def _clients(self) -> Iterator[int]:
        """Those where others wait for what they send."""
        for bus in self._buses:
            yield from bus.heard_by_others

    def _look_after(self) -> None:
        now_ns = self._loop.now_ns()
        self._gather()
        self._cell.look_after(now_ns, now_ns)
        self._tick = self._loop.call_at(now_ns + _TICK_NS, self._look_after)

    def _gather(self) -> None:
        """Take over what has happened since the last time."""
        self._cell.plant.stalls.behind(int(self._served[0]["late_ns"]))
        self._served["late_ns"] = 0
        for bus in self._buses:
            bus.gather()
