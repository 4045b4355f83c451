"""What comes from the nodes while they run: process data to samples, all else to the watches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import can

from micromanip.driver import Channel, Inbox, TransientError

from ..canbus.plan import Incoming, UnpackPlan
from .options import CanOpenOptions
from .plan import SYNC, NodePlan, PdoPlan
from .sampling import Sampling, SyncTimes
from .timing import Timing
from .watch import Watch

_HEARTBEAT, _EMERGENCY, _SDO_ANSWER = 0x700, 0x080, 0x580


class ReceivedPdo(Incoming):
    """A TPDO of a node; its inputs begin at index `first`."""

    def __init__(self, pdo: PdoPlan, first: int, latency_s: float, sampling: Sampling) -> None:
        self.title, self.identity = pdo.title, (pdo.mapping.identifier, False)
        self.length, self.fields, self.first = pdo.mapping.length, pdo.wires, first
        self.latency_ns = 0  # that of each sampling is its own
        self.channels = [Channel(field.name, pdo.options.rate_hz, latency_s) for field in self.fields]
        self.sampling = sampling
        self.pdos = self.lost = self.repeated = 0
        self._plan = UnpackPlan(self.fields)

    def take(self, data: bytes, time_ns: int, inbox: Inbox) -> None:
        """Put the samples of a frame that was received at `time_ns` into `inbox`, if it is a fresh one.

        Raises TransientError for one that is too short.
        """
        data = bytes(self.whole(data))
        self.pdos += 1
        taken = self.sampling.taken(time_ns, data)
        if taken is None:
            self.repeated += 1
            return
        taken_ns, lost = taken
        self.lost += lost
        inbox.put_all(self.first, self._plan.values(data), taken_ns, 0, lost)


Taker = Callable[[bytes, int, Inbox], None]


class Receiver:
    """Sorts the frames of a running bus."""

    def __init__(self, options: CanOpenOptions, nodes: Sequence[NodePlan], timing: Timing) -> None:
        self.channels: list[Channel] = []
        self.pdos: list[ReceivedPdo] = []
        self.syncs = SyncTimes()
        self.watches = {plan.name: Watch(plan.name, plan.options.heartbeat_ms) for plan in nodes}
        self._counters = dict.fromkeys(("emergencies", "foreign_syncs"), 0)
        self._sync_hz = options.sync_hz
        self._timing = timing
        self._takers: dict[int, Taker] = {SYNC: self._foreign_sync}
        for plan in nodes:
            node_id, watch = plan.options.node_id, self.watches[plan.name]
            self._takers[_HEARTBEAT + node_id] = self._heartbeat(watch)
            self._takers[_EMERGENCY + node_id] = self._emergency(watch)
        self.watched = list(self._takers)
        """Identifiers of what is no process data, and to be judged."""
        for pdo in (pdo for plan in nodes for pdo in plan.tpdos):
            latency_s = timing.input_latency_s(pdo)
            self.pdos.append(ReceivedPdo(pdo, len(self.channels), latency_s, self._sampling(pdo)))
            self.channels += self.pdos[-1].channels
            self._takers[pdo.mapping.identifier] = self.pdos[-1].take
        self.identifiers = [*self._takers, *(_SDO_ANSWER + plan.options.node_id for plan in nodes)]
        """All that the driver wants to hear."""

    @property
    def overdue_ns(self) -> int:
        """From then on the heartbeat of a node is missing."""
        return min(watch.overdue_ns for watch in self.watches.values())

    @property
    def counters(self) -> Mapping[str, int]:
        """What came."""
        summed = {name: sum(getattr(pdo, name) for pdo in self.pdos) for name in ("pdos", "lost", "repeated", "short")}
        return {**summed, **self._counters}

    def clear(self) -> None:
        """Forget when PDOs came: the bus is opened anew."""
        self.syncs.clear()
        for pdo in self.pdos:
            pdo.sampling.clear()

    def take(self, frames: Sequence[tuple[can.Message, int]], began_ns: int, inbox: Inbox) -> None:
        """Sort `frames`, which were taken off the bus from `began_ns` on.

        Raises TransientError for a PDO that is too short, when all others have been taken; what the watches raise.
        """
        broken: TransientError | None = None
        for message, time_ns in frames:
            taker = self._takers.get(message.arbitration_id)
            if taker is None or message.is_extended_id or message.is_remote_frame:
                continue
            try:
                taker(bytes(message.data), time_ns, inbox)
            except TransientError as problem:
                broken = problem
        # By the time of the frames: what a worker that was held up finds is old, and no reason to miss a heartbeat.
        now_ns = frames[-1][1] if frames else began_ns
        for watch in self.watches.values():
            watch.check(now_ns)
        if broken is not None:
            raise broken

    def _sampling(self, pdo: PdoPlan) -> Sampling:
        frame_ns = round(self._timing.duration_s(pdo.mapping.length) * 1e9)
        latency_ns = round(pdo.options.latency_us * 1e3)
        every = pdo.mapping.transmission
        if self._sync_hz is None or not 1 <= every <= 240:  # 0 is answered at a SYNC of the node's choice
            return Sampling(self.syncs, 0, frame_ns, latency_ns, 0, 0)
        waiting_ns = round(self._timing.arrival_s(pdo.mapping.identifier) * 1e9)
        return Sampling(self.syncs, every, frame_ns, latency_ns, round(1e9 / self._sync_hz), waiting_ns)

    def _heartbeat(self, watch: Watch) -> Taker:
        return lambda data, time_ns, _: watch.heartbeat(data, time_ns)

    def _emergency(self, watch: Watch) -> Taker:
        def take(data: bytes, time_ns: int, inbox: Inbox) -> None:  # noqa: ARG001
            self._counters["emergencies"] += 1
            watch.emergency(data)

        return take

    def _foreign_sync(self, data: bytes, time_ns: int, inbox: Inbox) -> None:  # noqa: ARG002
        self._counters["foreign_syncs"] += 1
