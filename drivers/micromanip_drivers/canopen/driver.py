"""The driver ``canopen``: nodes with an EDS file, their process data by PDO.

The `canopen` library reads the EDS files and knows the SDO protocol. The bus itself is ours: one receive loop
(``canbus.link``) in the thread of the worker, and no Notifier, since its thread would hide errors and give frames the
time at which Python came to them. SDO is spoken only while the bus is opened, by that same loop and until a deadline
(``sdo.py``, ``boot.py``); nothing but SYNC, PDOs and heartbeats is on the bus afterwards.

When it is closed the nodes are left as they are: a node that moves its outputs when it is stopped must not be stopped
here, and one with a watchdog makes them safe by itself.

The PDOs of a configuration fill the tables of the compiled functions.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from micromanip.driver import (
    Answer,
    BusDriver,
    BusError,
    Channel,
    Inbox,
    LinkError,
    Load,
    Steady,
    StillOpening,
    Task,
    TransientError,
    Watchdog,
)

from ..canbus.link import CanLink, LinkOptions
from ..canbus.plan import Outgoing
from ..canbus.tables import Tables
from .boot import boot
from .options import CanOpenOptions
from .plan import SYNC, PdoPlan, Timing, plan_nodes
from .probe import probe
from .receiving import OPERATIONAL, ReceivedPdo, Receiver
from .sampling import CONTEXT, SyncTimes

_HEARTBEAT = 0x700
_OPEN_NS = 900_000_000
_COUNTED = ("frames_in", "frames_out", "pdos", "lost", "repeated")


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
        self._sent: list[Outgoing] = []
        self._sync_ns = round(self._timing.duration_s(0) * 1e9)
        self._tables: PdoTables | None = None
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
    def silence(self) -> Watchdog | None:
        keys = [plan.options.silence for plan in self._nodes if plan.rpdos]
        return keys[0] if len(set(keys)) == 1 else None

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
            elif plan.options.watchdog is not None and plan.options.watchdog.words:
                watched.append(f"{plan.name} {plan.options.watchdog.words}")
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
        return self._link.loads(*self._timing.load())

    def open(self) -> None:
        try:
            self._link.open()
            self._receiver.clear()
            deadline_ns = time.monotonic_ns() + _OPEN_NS
            self._found = boot(self._link, self._options, self._nodes, self._receiver.watches, deadline_ns)
        except StillOpening:
            raise
        except TransientError as problem:  # there is no second try here: that is the worker's
            self._link.close()
            raise LinkError(str(problem)) from problem
        except BusError:
            self._link.close()
            raise
        if self._tables is not None and (raw := self._link.raw_socket) is not None:
            self._tables.hold(*raw, time.monotonic_ns())
            self._tables.expect_heartbeats(self._receiver.overdue_ns)

    def read_outputs(self) -> Sequence[float | None]:
        return [self._found.get(channel.name) for channel in self._outputs]

    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> None:  # noqa: ARG002
        if self._tables is not None:
            self._tables.complain(self._link)
        sent, sent_ns = self._sent[task], time.monotonic_ns()  # the time before: held up, values count as older
        self._link.send(sent.frame(values))
        if task == self._sync_task:
            self._receiver.syncs.add(sent_ns + self._sync_ns)

    def receive(self, inbox: Inbox, until_ns: int) -> None:
        began_ns = time.monotonic_ns()
        left = self._tables.taken(self._link) if self._tables is not None else []
        self._receiver.take(left or self._link.receive(until_ns), began_ns, inbox)
        if self._tables is not None:
            self._tables.expect_heartbeats(self._receiver.overdue_ns)

    def close(self) -> None:
        if self._tables is not None:
            self._tables.let_go()
        self._link.close()

    def steady(self) -> Steady | None:
        received, sent, watched = self._receiver.pdos, self._sent, self._receiver.watched
        if not self._link.is_plain or not PdoTables.have_room(received, sent, len(watched)):
            return None
        from . import exchange  # compiled: loaded only where it is going to be called

        tables = PdoTables(received, sent, watched, self._receiver.syncs, (self._sync_task, self._sync_ns))
        self._tables = tables
        receive, send = exchange.ENTRIES.addresses
        return Steady(receive, send, tables.record, lambda: tables.descriptor)

    def statistics(self) -> Mapping[str, int]:
        counts = {**self._link.statistics(), **self._receiver.counters}
        if self._tables is not None:
            counts |= {name: counts[name] + self._tables.counted(name) for name in _COUNTED}
        return counts

    def probe(self, seconds: float) -> Iterator[Answer]:
        return probe(self._options, {node.node_id: name for name, node in self._options.nodes.items()}, seconds)

    @classmethod
    def discover(cls, section: Mapping[str, Any], seconds: float) -> tuple[str, Iterator[Answer]]:
        options = LinkOptions.of(section)
        return options.device, probe(options, {}, seconds)

    @property
    def _sync_task(self) -> int:
        """The task that sends it; -1 for none."""
        return -1 if self._options.sync_hz is None else 0

    def _add_tasks(self) -> None:
        options = self._options
        if options.sync_hz is not None:
            self._tasks.append(Task("SYNC", options.sync_hz, serves_outputs=True))
            self._sent.append(Outgoing((SYNC, False), b""))
        for pdo in (pdo for plan in self._nodes for pdo in plan.rpdos):
            self._add_rpdo(pdo)
        if options.heartbeat_period_ms is not None:
            self._tasks.append(Task("heartbeat", 1e3 / options.heartbeat_period_ms, serves_outputs=True))
            self._sent.append(Outgoing((_HEARTBEAT + options.own_node_id, False), bytes((OPERATIONAL,))))

    def _add_rpdo(self, pdo: PdoPlan) -> None:
        latency_s = self._timing.output_latency_s(pdo)
        sent = Outgoing((pdo.mapping.identifier, False), bytes(pdo.mapping.length), pdo.wires, len(self._outputs))
        for wire, safe in zip(pdo.wires, pdo.safe, strict=True):
            self._outputs.append(Channel(wire.name, pdo.options.rate_hz, latency_s, safe))
        self._tasks.append(Task(pdo.title, pdo.options.rate_hz, sent.indices))
        self._sent.append(sent)


class PdoTables(Tables):
    """Those of a CANopen bus."""

    def __init__(
        self,
        received: Sequence[ReceivedPdo],
        sent: Sequence[Outgoing],
        watched: Sequence[int],
        syncs: SyncTimes,
        sync: tuple[int, int],
    ) -> None:
        """From now on all that is known of SYNCs and answers is kept in it.

        `watched` identifiers are Python's; `sync` is the task that sends it, -1 for none, and its time on the bus (ns).
        """
        super().__init__(CONTEXT, received, sent, False, [(identifier, False) for identifier in watched])
        self._c["sync_task"], self._c["sync_frame_ns"] = sync
        syncs.move_to(self._c["syncs"])
        for row, pdo in zip(self._c["sampling"], received, strict=False):
            pdo.sampling.move_to(row)

    def expect_heartbeats(self, overdue_ns: int) -> None:
        """From then on one is missing."""
        self._c["overdue_ns"] = overdue_ns
