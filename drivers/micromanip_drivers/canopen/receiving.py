"""What comes from the nodes while they run: process data to samples, all else to a watch over each."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence

import can
from canopen.emcy import EmcyError

from micromanip.driver import Channel, DeviceFault, Inbox, LinkError, TransientError

from ..canbus.plan import Incoming, UnpackPlan
from .options import CanOpenOptions
from .plan import SYNC, NodePlan, PdoPlan, Timing
from .sampling import Sampling, SyncTimes

OPERATIONAL = 5
_STATES = {0: "INITIALISING", 4: "STOPPED", OPERATIONAL: "OPERATIONAL", 127: "PRE-OPERATIONAL"}
_GUARD_TOGGLE = 0x80
_REPORT = struct.Struct("<HB")
_OF_COMMUNICATION = (0x81, 0x82)
# CiA 301 names the codes of the communication one by one; of the others the library knows the class
_COMMUNICATION = {
    0x8110: "CAN overrun",
    0x8120: "CAN error passive",
    0x8130: "heartbeat of ours missing",
    0x8140: "recovered from bus-off",
    0x8150: "identifier collision",
    0x8210: "PDO too short",
    0x8220: "PDO too long",
    0x8240: "SYNC of wrong length",
    0x8250: "no outputs in time",
}


class Watch:
    """What a node said of itself since it was opened."""

    def __init__(self, name: str, heartbeat_ms: int) -> None:
        self._name = name
        self._heartbeat_ms = heartbeat_ms
        self._heard_ns = 0
        self._fault: str | None = None
        self._left: str | None = None
        self.state = "silent"
        """What its last heartbeat said."""
        self.operational = False
        """True if its last heartbeat said so."""
        self._running = False

    def begin(self, time_ns: int) -> None:
        """It is told to start, at `time_ns`: it need not be OPERATIONAL yet, and may still say that it missed us."""
        self._heard_ns, self._fault, self._left = time_ns, None, None
        self.state, self.operational, self._running = "silent", False, False

    def run(self) -> None:
        """All nodes have started: from now on it has to stay OPERATIONAL."""
        self._running = True

    @property
    def overdue_ns(self) -> int:
        """From then on its heartbeat is missing."""
        return self._heard_ns + self._heartbeat_ms * 1_000_000

    def heartbeat(self, data: bytes, time_ns: int) -> None:
        """Its heartbeat, which may say that it restarted or left OPERATIONAL."""
        if not data:
            return
        state = data[0] & ~_GUARD_TOGGLE
        self._heard_ns, self.state = time_ns, _STATES.get(state, f"in state {state}")
        self.operational = state == OPERATIONAL
        if state == 0:
            self._left = "has restarted (boot-up message)"
        elif self._running and not self.operational:
            self._left = f"is {self.state}, no longer OPERATIONAL"

    def emergency(self, data: bytes) -> None:
        """Its emergency message, or the one that takes it back."""
        if len(data) < _REPORT.size:
            return
        code, register = _REPORT.unpack_from(data)
        if code & 0xFF00 == 0:
            self._fault = self._fault if register else None  # one error of several has gone
        elif self._running or not blames_bus(code):
            self._fault = f"emergency {emergency_text(code)}, error register 0x{register:02X}"

    def check(self, now_ns: int) -> None:
        """Raises DeviceFault while it reports an emergency, LinkError if it left OPERATIONAL or is silent for too long.

        The emergency first: a node that leaves OPERATIONAL says why by one.
        """
        if self._fault is not None:
            raise DeviceFault(f"node {self._name} reports {self._fault}")
        if self._left is not None:
            raise LinkError(f"node {self._name} {self._left}")
        if now_ns > self.overdue_ns:
            raise LinkError(f"node {self._name} gave no heartbeat for {self._heartbeat_ms} ms")


def blames_bus(code: int) -> bool:
    """True for an emergency's code that blames the bus, or us."""
    return code >> 8 in _OF_COMMUNICATION


def emergency_text(code: int) -> str:
    """An emergency's code in words."""
    words = _COMMUNICATION.get(code) or EmcyError(code, 0, b"", 0.0).get_desc().lower()
    return f"0x{code:04X} ({words})" if words else f"0x{code:04X}"


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
