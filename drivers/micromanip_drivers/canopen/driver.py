"""The driver ``canopen``: nodes with an EDS file, their process data by PDO.

The `canopen` library reads the EDS files and knows the SDO protocol. The bus itself is ours: one receive loop
(``canbus.link``) in the thread of the worker, and no Notifier, since its thread would hide errors and give frames the
time at which Python came to them. SDO is spoken only while the bus is opened, by that same loop and until a deadline
(``sdo.py``, ``boot.py``); nothing but SYNC, PDOs and heartbeats is on the bus afterwards.

When it is closed the nodes are left as they are: a node that moves its outputs when it is stopped must not be stopped
here, and one with a watchdog makes them safe by itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import can

from micromanip.driver import Answer, BusDriver, BusError, Channel, Inbox, LinkError, Load, Task, TransientError

from ..canbus.link import CanLink
from .boot import boot
from .options import CanOpenOptions
from .plan import SYNC, PdoPlan, plan_nodes
from .probe import probe
from .receiving import Receiver
from .timing import Timing
from .watch import OPERATIONAL

_HEARTBEAT = 0x700
_OPEN_NS = 900_000_000

Performed = Callable[[Sequence[float]], None]


class CanOpen(BusDriver):
    """CANopen nodes on one bus."""

    Options = CanOpenOptions

    def __init__(self, options: CanOpenOptions, folder: Path) -> None:
        self._options, self._folder = options, folder
        self._nodes = plan_nodes(options, folder)
        self._timing = Timing(options, self._nodes)
        self._receiver = Receiver(options, self._nodes, self._timing)
        self._link = CanLink(options, [(identifier, False) for identifier in self._receiver.identifiers])
        self._outputs: list[Channel] = []
        self._tasks: list[Task] = []
        self._performed: list[Performed] = []
        self._found: dict[str, float] = {}
        """What the nodes had on their outputs when they were opened."""
        self._add_tasks()

    @property
    def device(self) -> str:
        return self._options.device

    @property
    def files(self) -> Sequence[Path]:
        return tuple(self._folder / node.eds for node in self._options.nodes.values())

    @property
    def real_because(self) -> str | None:
        return self._options.real_because

    @property
    def watchdog(self) -> str | None:
        """Of all nodes with outputs, or none: a single output that nothing makes safe is an output at large."""
        watched: list[str] = []
        for plan in self._nodes:
            waits = "RPDO event timer" if plan.options.watchdog_by == "rpdo" else "consumer heartbeat"
            if not plan.rpdos:
                continue
            if plan.options.watchdog_ms is not None:
                watched.append(f"{waits} of {plan.name}, {plan.options.watchdog_ms} ms")
            elif plan.options.watchdog is not None:
                watched.append(f"{plan.options.watchdog} of {plan.name}")
            else:
                return None
        return "; ".join(watched) or None

    @property
    def inputs(self) -> Sequence[Channel]:
        return self._receiver.channels

    @property
    def outputs(self) -> Sequence[Channel]:
        return self._outputs

    @property
    def tasks(self) -> Sequence[Task]:
        return self._tasks

    def loads(self) -> Sequence[Load]:
        return [self._timing.load()]

    def open(self) -> None:
        try:
            self._link.open()
            self._receiver.clear()
            deadline_ns = time.monotonic_ns() + _OPEN_NS
            self._found = boot(self._link, self._options, self._nodes, self._receiver.watches, deadline_ns)
        except TransientError as problem:  # there is no second try here: that is the worker's
            self._link.close()
            raise LinkError(str(problem)) from problem
        except BusError:
            self._link.close()
            raise

    def read_outputs(self) -> Sequence[float | None]:
        return [self._found.get(channel.name) for channel in self._outputs]

    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> None:  # noqa: ARG002
        self._performed[task](values)

    def receive(self, inbox: Inbox, until_ns: int) -> None:
        began_ns = time.monotonic_ns()
        self._receiver.take(self._link.receive(until_ns), began_ns, inbox)

    def close(self) -> None:
        self._link.close()

    def statistics(self) -> Mapping[str, int]:
        return {**self._link.statistics(), **self._receiver.counters}

    def probe(self, seconds: float) -> Iterator[Answer]:
        return probe(self._options, seconds)

    def _add_tasks(self) -> None:
        options = self._options
        if options.sync_hz is not None:
            self._tasks.append(Task("SYNC", options.sync_hz))
            self._performed.append(self._sync())
        for pdo in (pdo for plan in self._nodes for pdo in plan.rpdos):
            self._add_rpdo(pdo)
        if options.heartbeat_period_ms is not None:
            beat = _message(_HEARTBEAT + options.own_node_id, bytes((OPERATIONAL,)))
            self._tasks.append(Task("heartbeat", 1e3 / options.heartbeat_period_ms))
            self._performed.append(lambda _: self._link.send(beat))

    def _add_rpdo(self, pdo: PdoPlan) -> None:
        first = len(self._outputs)
        latency_s = self._timing.output_latency_s(pdo)
        for wire, safe in zip(pdo.wires, pdo.safe, strict=True):
            self._outputs.append(Channel(wire.name, pdo.options.rate_hz, latency_s, safe))
        end = len(self._outputs)
        self._tasks.append(Task(pdo.title, pdo.options.rate_hz, tuple(range(first, end))))
        self._performed.append(self._rpdo(pdo, first, end))

    def _sync(self) -> Performed:
        message = _message(SYNC, b"")
        on_bus_ns = round(self._timing.duration_s(0) * 1e9)

        def perform(_: Sequence[float]) -> None:
            sent_ns = time.monotonic_ns()  # before: where we are held up, values count as older than they are
            self._link.send(message)
            self._receiver.syncs.add(sent_ns + on_bus_ns)

        return perform

    def _rpdo(self, pdo: PdoPlan, first: int, end: int) -> Performed:
        identifier, length = pdo.mapping.identifier, pdo.mapping.length
        link, wires = self._link, pdo.wires

        def perform(values: Sequence[float]) -> None:
            frame = 0
            for wire, value in zip(wires, values[first:end], strict=True):
                frame |= wire.bits(value)
            link.send(_message(identifier, frame.to_bytes(length, "little")))

        return perform


def _message(identifier: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
