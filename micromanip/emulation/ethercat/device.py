"""The terminals of one driver `ethercat`, with the plant behind them.

While nothing is amiss compiled code serves the line (``serving.py``); what is rare, and every fault of the line, goes
through Python. Both ways use the same controllers, plant and amplifier.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from micromanip.emulation.amplifier import Amplifier
from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.emulated import EmulatedDevice, Surroundings, Wires
from micromanip.emulation.line.device import PAUSE_NS, ServedDevice
from micromanip.emulation.line.device_line import DeviceLine
from micromanip.emulation.line.faults import parsed as line_fault
from micromanip.emulation.line.port import Hear, Peer
from micromanip.errors import UsageError
from micromanip.rt.io.sockets import POLLIN
from micromanip.rt.jit import prepare
from micromanip.testbus.event_loop import EventLoop

from .controller import system_ns
from .line import NEAR, NOWHERE, Line
from .port import EthernetPort
from .serving import (
    HAS_EVENTS,
    IDLE,
    NOBODY,
    SERVED,
    lay_out_readings,
    outputs_taken,
    serve,
    serve_on,
)
from .terminal import terminal_of
from .terminal_faults import KINDS, TerminalFaults, parsed
from .wiring import wire

FRAMES = "frames"
"""What the device sends, by the name that commands use."""
_TURN_NS = 30_000
"""From the first terminal to the last and back, of a ring to the last: cables so long that this process has answered by
then, and the line's clocks can tell what it takes. A real line takes some 2 us for each terminal."""
_TURN_EACH_NS = 500_000_000
"""Two or three frames come back late by a turn in Python. Meanwhile compiled code looks after plant and watchdogs, and
who asks for figures gets those up to now."""
_OF_FRAMES = ("drop", "delay", "duplicate", "reorder", "hang", "unplug")


class EthercatDevice(ServedDevice):
    """The line of one driver `ethercat`."""

    def __init__(
        self, keys: Any, loop: EventLoop, cell: EmulatedCell, wires: Wires, amplifier: Amplifier | None
    ) -> None:
        """`keys` are the driver's options. Raises DeviceUnavailable where no veth pair can be had."""
        super().__init__(keys, loop, cell, amplifier, _TURN_EACH_NS)
        self._names = list(keys.terminals)
        terminals = [terminal_of(name, keys.terminals[name]) for name in self._names]
        is_ring = keys.return_interface is not None
        hop_ns = _TURN_NS // max(1, (1 if is_ring else 2) * (len(terminals) - 1))
        self.slaves = Line(terminals, self._left_op, is_ring, hop_ns)
        self._served = np.zeros(1, SERVED)
        self._served[0]["turn_ns"] = _TURN_NS
        self._served[0]["port"]["socket"]["descriptor"] = -1  # 0 is standard input, by which commands come
        self.slaves.relinked = self._relinked
        self._faults = TerminalFaults(loop, self._names, self.slaves, self._left_op)
        self._terminals = wire(self._served[0], self.slaves, keys.terminals, cell, wires)
        for terminal, arrived in zip(self._terminals, self._served[0]["arrived"], strict=False):
            self.count_in(terminal.outputs, arrived)
        self.signals = [name for each in self._terminals for name, counts in each.inputs if not counts]
        self._polled = PollTable()
        loop.serve_by(self._serve_on)
        prepare(serve, serve_on, lay_out_readings, outputs_taken)
        self._ports: list[EthernetPort] = []
        try:  # the near end and, of a ring, the far one
            for end, interface in enumerate(filter(None, (keys.interface, keys.return_interface))):
                line = DeviceLine(loop, partial(self._make_port, interface), end)
                line.attach(partial(self._hear, end))
                self._lines.append(line)
        except BaseException:
            self.close()
            raise

    def _make_port(self, interface: str, hear: Hear) -> EthernetPort:
        self._ports.append(EthernetPort(self._loop, interface, hear))
        return self._ports[-1]

    @property
    def ready(self) -> str:
        outputs = sum(len(each.outputs) for each in self._terminals)
        return f"{self._name}: {len(self._names)} terminals, {len(self.signals)} signals, {outputs} outputs"

    @property
    def _name(self) -> str:
        return " and back by ".join(port.name for port in self._ports)

    @property
    def messages(self) -> list[str]:
        return [FRAMES]

    def start(self, now_ns: int) -> None:
        for application in self.slaves.applications:
            application.switch_on(now_ns)
        self.slaves.relink()
        super().start(now_ns)

    def stop_counter(self, message: str, for_s: float | None) -> None:  # noqa: ARG002
        raise UsageError(f"{self._name}: the master counts the frames, terminals send them back as they come")

    def reboot(self, for_s: float) -> None:
        self._faults.reboot(for_s)

    def inject(self, fault: Mapping[str, Any]) -> None:
        if fault.get("kind") in KINDS:
            self._faults.befall(parsed(dict(fault)))
            return
        injected = line_fault(dict(fault))
        if injected.kind not in _OF_FRAMES:
            raise UsageError(f"fault {injected.kind}: {self.ready} has nothing of the kind")
        for line in self._lines:
            line.inject(injected)

    def _relinked(self) -> None:
        """Who has a neighbour, and which way frames go, has changed."""
        for port, way in zip(self._served[0]["port"], self.slaves.ways, strict=True):
            port["first"], port["end"], port["out"] = way.first, way.end, way.out

    def clear(self) -> None:
        super().clear()
        self._faults.clear()

    def report(self) -> dict[str, Any]:
        """With the first terminal's clock at a time of this machine (CLOCK_MONOTONIC)."""
        first, now_ns = self.slaves.controllers[0], time.monotonic_ns()
        clock = {"monotonic_ns": now_ns, "system_ns": int(system_ns(first, now_ns)), "ppb": int(first["clock_ppb"])}
        states = {n: a.state for n, a in zip(self._names, self.slaves.applications, strict=True)}
        return {**super().report(), "clock": clock, "states": states}

    def _left_op(self) -> None:
        self._gather()
        if self._amplifier is not None:
            self._amplifier.trip(self._cell.plant.time_ns)

    def _readable(self, end: int) -> None:
        now_ns = self._loop.now_ns()
        port = self._served[0]["port"][end]
        if not self.is_plain(now_ns) and port["next"] >= port["waiting"]:
            self._gather()
            self._ports[end].read()
            return
        self._serve_end(end)
        self._upkeep.behind_a_frame()

    def _serve_end(self, end: int) -> None:
        """Serve all that has come in at an end."""
        plant, d = self._cell.plant, self._served[0]
        self._lend()
        more = True
        while more:
            more = serve(self._served, end, self.slaves.controllers, *plant.arrays)
            plant.time_ns = int(d["time_ns"])
            if more:
                self._serve_applications()

    def _lend(self) -> None:
        """Tell compiled code when it is in the plant, and whether the amplifier follows."""
        self._served["time_ns"] = self._cell.plant.time_ns
        self._served["follows"] = self._amplifier is None or self._amplifier.follows

    def _serve_applications(self) -> None:
        self._gather()
        self.slaves.serve(self._loop.now_ns())
        self._lend()

    def _serve_on(self, descriptors: Sequence[int], until_ns: int | None) -> int:
        """Wait in the event loop's stead, see ``EventLoop.serve_by``, while a conversation is under way."""
        now_ns, plant, d = self._loop.now_ns(), self._cell.plant, self._served[0]
        if not self.is_plain(now_ns):
            self._upkeep.serves_no_more()
            return 0
        if any(port["next"] < port["waiting"] for port in d["port"]):
            return 0
        self._lend()
        d["awake_ns"] = self.slaves.awake_ns
        code = serve_on(
            self._served,
            self.slaves.controllers,
            *plant.arrays,
            self._cell.errors.record,
            self._polled.of(descriptors),
            now_ns + PAUSE_NS if until_ns is None else until_ns,
            self._upkeep.due_ns,
        )
        plant.time_ns, self.slaves.awake_ns = int(d["time_ns"]), int(d["awake_ns"])
        if code == HAS_EVENTS:
            self._serve_applications()
            for end in range(len(self._ports)):
                self._serve_end(end)
        if code == NOBODY:
            self._upkeep.serves_no_more()
        elif code != IDLE:
            self._upkeep.behind_a_frame()
        return int(d["rested_ns"])

    def is_plain(self, now_ns: int) -> bool:
        self._heard_ns = max(self._heard_ns, int(self._served[0]["heard_ns"]))
        return super().is_plain(now_ns)

    def _gather(self) -> None:
        d = self._served[0]
        frames = int(d["frames"])
        self.figures.not_understood += int(d["strange"])
        d["strange"] = 0
        if frames == 0:
            return
        self.figures.received += frames
        self.figures.sent += frames
        self._ports[NEAR].carried(frames, int(d["bytes"]))
        d["frames"] = d["bytes"] = 0
        self._heard_ns = max(self._heard_ns, int(d["heard_ns"]))
        self.has_taken(d)

    def _hear(self, end: int, data: bytes, peer: Peer) -> None:
        """One frame that came in at an end, through Python."""
        out = self.slaves.ways[end].out
        if out == NOWHERE:
            return
        now_ns, d = self._loop.now_ns(), self._served[0]
        self._cell.advance_to(now_ns)
        self._read()
        before = int(self.slaves.controllers["outputs_count"].sum())
        back = self.slaves.passed(data, now_ns, end)
        if back is None:
            self.figures.not_understood += 1
            return
        self.figures.received += 1
        if int(self.slaves.controllers["outputs_count"].sum()) != before:
            self.hears(now_ns)
        d["follows"] = 0  # the amplifier sees to it
        if outputs_taken(self._served, self.slaves.controllers, self._cell.plant.arrays[0]):
            self._command(now_ns)
        if now_ns < self._silent_until_ns:
            self.figures.silent += 1
            return
        self._lines[out].answer(peer if out == end else self._ports[out], back)
        self.figures.sent += 1

    def _command(self, now_ns: int) -> None:
        d = self._served[0]
        values = {
            name: float(d["value"][k][i])
            for k, terminal in enumerate(self._terminals)
            for i, name in enumerate(terminal.outputs)
            if name is not None
        }
        if self._amplifier is not None:
            self._amplifier.take(values, now_ns)
        self._cell.advance_to(now_ns)

    def _read(self) -> None:
        d, cell = self._served[0], self._cell
        for k, terminal in enumerate(self._terminals):
            d["reading"][k][: len(terminal.inputs)] = [
                self._samples(signal) if counts else cell.read(signal) for signal, counts in terminal.inputs
            ]
        lay_out_readings(self._served, self.slaves.controllers)

    def _samples(self, signal: str) -> float:
        return float(self._cell.plant.samples(signal)) if signal in self._cell.plant.inputs else 0.0

    def _look_after(self) -> None:
        self._gather()
        now_ns = self._loop.now_ns()
        self._cell.keep_up(now_ns)
        self.slaves.tick(now_ns)
        for end, port in enumerate(self._ports):
            served = self._served[0]["port"][end]
            if port.lend(served["socket"], partial(self._readable, end)):
                served["waiting"] = served["next"] = 0


def emulate_ethercat(name: str, surroundings: Surroundings) -> EmulatedDevice:
    """The terminals of the driver called `name`; their own watchdog is the amplifier's too."""
    wires = surroundings.wires(name)
    amplifier = None
    if wires.outputs:
        amplifier = Amplifier(surroundings.cell.plant, wires.rest_V, None)
        surroundings.cell.amplifiers.append(amplifier)
    return EthercatDevice(surroundings.options(name), surroundings.loop, surroundings.cell, wires, amplifier)


class PollTable:
    """Rows of descriptor and events, made anew only when the descriptors are others."""

    def __init__(self) -> None:
        self._rows = np.zeros((0, 2), np.int32)

    def of(self, descriptors: Sequence[int]) -> Any:
        """Table (n, 2) of these."""
        if len(descriptors) != len(self._rows) or not np.array_equal(self._rows[:, 0], descriptors):
            self._rows = np.array([(each, POLLIN) for each in descriptors], np.int32).reshape(-1, 2)
        return self._rows
