"""What emulated devices on lines of their own have in common, and those whose lines compiled code serves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from micromanip.emulation.amplifier import Amplifier
from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.emulated import Wires
from micromanip.emulation.messages import Due, MessageFigures, Periodic, Sender, Upkeep
from micromanip.errors import UsageError
from micromanip.testbus.event_loop import EventLoop

from .device_line import DeviceLine, report_of
from .faults import parsed
from .port import Peer

_TICK_NS = 1_000_000


class Behind:
    """The cell behind a device, by the names of the driver's channels."""

    def __init__(self, cell: EmulatedCell, wires: Wires, amplifier: Amplifier | None) -> None:
        self.amplifier = amplifier
        self._cell, self._wires = cell, wires

    def signal(self, channel: str) -> str:
        """What a channel is called in the cell: as configured, else as it is."""
        return self._wires.signals.get(channel, channel)

    def advance_to(self, time_ns: int) -> None:
        """Let time pass in the cell."""
        self._cell.advance_to(time_ns)

    def has(self, channel: str) -> bool:
        """Whether the cell measures it."""
        return self._cell.has(self.signal(channel))

    def read(self, channel: str) -> float:
        """What the sensor behind a channel says; 0 where there is none."""
        return self._cell.read(self.signal(channel))

    def voltage_V(self, channel: str) -> float:
        """What the amplifier puts out at an output; 0 for one that nobody uses."""
        if self.amplifier is None:
            return 0.0
        return self.amplifier.in_force.get(self._wires.outputs.get(channel, ""), 0.0)

    def write(self, values: Mapping[str, float]) -> None:
        """A command for some outputs, now; those that the cell doesn't have do nothing."""
        named = {self._wires.outputs[name]: value for name, value in values.items() if name in self._wires.outputs}
        if self.amplifier is not None and named:
            now_ns = self._cell.clock()
            self.amplifier.take(named, now_ns)
            self._cell.advance_to(now_ns)

    def trip(self, now_ns: int) -> None:
        """The amplifier is switched off."""
        if self.amplifier is not None:
            self.amplifier.trip(now_ns)


class LineDevice(Sender):
    """One device on one line."""

    faults: tuple[str, ...] = ()
    """Those that it plays itself."""

    def __init__(self, loop: EventLoop, line: DeviceLine, behind: Behind) -> None:
        super().__init__(loop)
        self.signals: list[str] = []
        self._line, self._behind = line, behind
        self._off_until_ns = 0
        self._began_ns = loop.now_ns()
        line.attach(self._arrived)

    @property
    def description(self) -> str:
        """What it is, and does: "binary board, 1 message out, 1 in"."""
        raise NotImplementedError

    @property
    def ready(self) -> str:
        return f"{self._line.port.name}: {self.description}"

    def sends(self, message: Due, send: Callable[[Due], None]) -> None:
        """Call `send` whenever `message` is due, the cell being where it is then."""
        self.periodic.append(Periodic(self._loop, self.figures, message, self._behind.advance_to, send))

    def start(self, now_ns: int) -> None:
        self._began_ns = now_ns
        super().start(now_ns)
        if all(periodic.message.period_ns > _TICK_NS for periodic in self.periodic):
            self._tick()

    def hear(self, data: bytes, peer: Peer) -> None:
        """Bytes came from `peer`; none at all mean that it has gone."""

    def reboot(self, for_s: float) -> None:
        """Be off for so long, with the amplifier; counters begin anew."""
        now_ns = self._loop.now_ns()
        self._off_until_ns = now_ns + round(for_s * 1e9)
        self._behind.trip(now_ns)
        self.be_off(self._off_until_ns)

    def inject(self, fault: Mapping[str, Any]) -> None:
        injected = parsed(dict(fault))
        if injected.kind in ("identity", "gcs_error") and injected.kind not in self.faults:
            raise UsageError(f"fault {injected.kind}: {self.ready} has nothing of the kind")
        self._line.inject(injected)

    def clear(self) -> None:
        self._line.clear()
        super().clear()

    def report(self) -> dict[str, Any]:
        return report_of(self.figures, [self._line], self._loop.now_ns() - self._began_ns)

    def close(self) -> None:
        self._line.close()

    def _arrived(self, data: bytes, peer: Peer) -> None:
        if not data or self._loop.now_ns() >= self._off_until_ns:
            self.hear(data, peer)

    def _tick(self) -> None:
        """Amplifiers and plant go on also while nobody talks."""
        now_ns = self._loop.now_ns()
        self._behind.advance_to(now_ns)
        self._loop.call_at(now_ns + _TICK_NS, self._tick)


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
