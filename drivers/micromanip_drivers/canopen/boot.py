"""Bringing the nodes into operation, and nothing into motion.

Each node is told to go to PRE-OPERATIONAL, where its PDOs rest; asked who it is; told what the configuration wants;
compared with what we will send and read; then started. It is never reset: a reset would restart a device that another
may be using, and some move their outputs by it. Written is what the node forgets when it is switched off, never its
permanent memory.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence

import can

from micromanip.driver import DeviceFault, IdentityMismatch, LinkError

from ..canbus.link import CanLink
from ..canbus.plan import UnpackPlan
from .dictionary import number
from .mapping import INVALID
from .options import CanOpenOptions
from .plan import NodePlan, PdoPlan
from .receiving import Watch, blames_bus, emergency_text
from .sdo import Sdo

_NMT = 0x000
_START = 1
_ENTER_PRE_OPERATIONAL = 128
_HEARTBEAT, _EMERGENCY = 0x700, 0x080

_NO_REMOTE = 0x40000000
_GENERIC_ERROR = 0x01
_COMMUNICATION_ERROR = 0x10
_IDENTITY = (("vendor_id", 1), ("product_code", 2), ("revision", 3), ("serial", 4))


def boot(
    link: CanLink,
    options: CanOpenOptions,
    nodes: Sequence[NodePlan],
    watches: Mapping[str, Watch],
    deadline_ns: int,
) -> dict[str, float]:
    """Set up the nodes and start them, until `deadline_ns`; what they had on their outputs before, as far as they tell.

    Raises LinkError for a node that does not answer or start, IdentityMismatch for one that is not what the
    configuration says, DeviceFault for one that reports an error.
    """
    found: dict[str, float] = {}
    for plan in nodes:
        _command(link, _ENTER_PRE_OPERATIONAL, plan)
    for plan in nodes:
        sdo = Sdo(link, plan, deadline_ns, _ignored)
        _reached(sdo, plan, deadline_ns)
        _identify(sdo, plan)
        _refuse_fault(sdo, plan)
        for pdo in plan.pdos:
            _configure(sdo, plan, pdo)
            _compare(sdo, plan, pdo)
        for pdo in plan.rpdos:
            found |= _outputs(sdo, pdo)
        _set_watch(sdo, plan, options.own_node_id)
        sdo.write(0x1017, 0, plan.heartbeat_period_ms)
    for plan in nodes:
        watches[plan.name].begin(time.monotonic_ns())
        _command(link, _START, plan)
    _started(link, nodes, watches, deadline_ns)
    return found


def _outputs(sdo: Sdo, pdo: PdoPlan) -> dict[str, float]:
    """Values of the objects that the RPDO carries, by the signals' names; without those that can't be read."""
    found: dict[str, float] = {}
    for wire, mapped in zip(pdo.wires, pdo.carried, strict=True):
        variable = mapped.variable
        if variable.readable and (raw := sdo.read_if_told(variable.index, variable.subindex)) is not None:
            data = ((raw & wire.mask) << wire.shift).to_bytes(8, "little")
            found[wire.name] = UnpackPlan([wire]).values(data)[0]
    return found


def _command(link: CanLink, command: int, plan: NodePlan) -> None:
    data = bytes((command, plan.options.node_id))
    link.send(can.Message(arbitration_id=_NMT, data=data, is_extended_id=False))


def _ignored(message: can.Message, time_ns: int) -> None:
    """PDOs, heartbeats and emergencies from before the start: the error register tells what still holds."""


def _reached(sdo: Sdo, plan: NodePlan, deadline_ns: int) -> None:
    while not sdo.answers():
        if time.monotonic_ns() >= deadline_ns:
            raise LinkError(f"node {plan.name} (number {plan.options.node_id}) does not answer")


def _identify(sdo: Sdo, plan: NodePlan) -> None:
    for key, subindex in _IDENTITY:
        wanted = getattr(plan.options.identity, key)
        if wanted is None:
            continue
        found = sdo.read(0x1018, subindex)
        if found != wanted:
            raise IdentityMismatch(
                f"node {plan.name} (number {plan.options.node_id}) has {key} 0x{found:X}, not 0x{wanted:X}"
            )


def _refuse_fault(sdo: Sdo, plan: NodePlan) -> None:
    """A communication error alone is no reason: a node that missed us has one until it hears of us again."""
    register = sdo.read(0x1001)
    if not register & ~(_GENERIC_ERROR | _COMMUNICATION_ERROR) and register != _GENERIC_ERROR:
        return
    told = f"node {plan.name} reports error register 0x{register:02X}"
    for code in _history(sdo, plan):
        if not blames_bus(code):
            told += f", last emergency {emergency_text(code)}"
            break
    raise DeviceFault(told)


def _history(sdo: Sdo, plan: NodePlan) -> Iterator[int]:
    """Codes of its emergencies, the latest first, as far as it keeps them."""
    if plan.dictionary.has(0x1003, 1):
        for i in range(sdo.read(0x1003, 0)):
            if plan.dictionary.has(0x1003, i + 1):
                yield sdo.read(0x1003, i + 1) & 0xFFFF


def _configure(sdo: Sdo, plan: NodePlan, pdo: PdoPlan) -> None:
    """Write what the configuration says otherwise than EDS and node; a PDO rests while its mapping changes.

    The bit that forbids asking for the PDO by a remote frame stays as the node has it. Nothing is written to one that
    is set up so already: it may not let that be written at all, or remember each writing.
    """
    mapping = pdo.mapping
    if not (mapping.to_write or mapping.transmission_to_write) or _other(sdo, pdo) is None:
        return
    has = sdo.read(mapping.parameters, 1)
    cob_id = plan.dictionary.value(mapping.parameters, 1) & ~(INVALID | _NO_REMOTE) | has & _NO_REMOTE
    sdo.write(mapping.parameters, 1, cob_id | INVALID)
    if mapping.transmission_to_write:
        sdo.write(mapping.parameters, 2, mapping.transmission)
    if mapping.to_write:
        sdo.write(mapping.mappings, 0, 0)
        for i, mapped in enumerate(mapping.objects):
            sdo.write(mapping.mappings, i + 1, mapped.entry)
        sdo.write(mapping.mappings, 0, len(mapping.objects))
    sdo.write(mapping.parameters, 1, cob_id)


def _compare(sdo: Sdo, plan: NodePlan, pdo: PdoPlan) -> None:
    """Whatever the EDS says, the node may have been set up otherwise: its values would be taken for others."""
    if (other := _other(sdo, pdo)) is not None:
        at, found, wanted = other
        raise IdentityMismatch(
            f"{pdo.title} is set up otherwise than {plan.dictionary.file.name} and the configuration say: "
            f"{number(*at)} is 0x{found:X}, not 0x{wanted:X}; give it map and transmission, or restore the node's "
            "defaults"
        )


def _other(sdo: Sdo, pdo: PdoPlan) -> tuple[tuple[int, int], int, int] | None:
    """The first object of a PDO that is not as it should be, what it is, and what it should be."""
    mapping = pdo.mapping
    wanted = {
        (mapping.parameters, 2): mapping.transmission,
        (mapping.mappings, 0): len(mapping.objects),
        **{(mapping.mappings, i + 1): mapped.entry for i, mapped in enumerate(mapping.objects)},
    }
    cob_id = sdo.read(mapping.parameters, 1)
    if cob_id & INVALID or cob_id & 0x7FF != mapping.identifier:
        return (mapping.parameters, 1), cob_id, mapping.identifier
    for at, value in wanted.items():
        if (found := sdo.read(*at)) != value:
            return at, found, value
    return None


def _set_watch(sdo: Sdo, plan: NodePlan, own_node_id: int) -> None:
    watchdog_ms = plan.options.watchdog_ms
    if watchdog_ms is None:
        return
    if plan.options.watchdog_by == "heartbeat":
        sdo.write(0x1016, 1, own_node_id << 16 | watchdog_ms)
        return
    for pdo in plan.rpdos:
        sdo.write(pdo.mapping.parameters, 5, watchdog_ms)


def _started(link: CanLink, nodes: Sequence[NodePlan], watches: Mapping[str, Watch], deadline_ns: int) -> None:
    """Wait until the heartbeats of all nodes say OPERATIONAL.

    A node whose watchdog still counts from our outputs before may trip meanwhile and fall back: it is told again.
    """
    by_heartbeat = {_HEARTBEAT + plan.options.node_id: plan for plan in nodes}
    by_emergency = {_EMERGENCY + plan.options.node_id: watches[plan.name] for plan in nodes}
    while True:
        now_ns = time.monotonic_ns()
        for message, time_ns in link.receive(deadline_ns):
            now_ns = time_ns  # what comes late was in time all the same
            if plan := by_heartbeat.get(message.arbitration_id):
                watches[plan.name].heartbeat(bytes(message.data), time_ns)
                if not watches[plan.name].operational:
                    _command(link, _START, plan)
            elif watch := by_emergency.get(message.arbitration_id):
                watch.emergency(bytes(message.data))
        for watch in watches.values():
            watch.check(now_ns)
        waiting = [plan.name for plan in nodes if not watches[plan.name].operational]
        if not waiting:
            break
        if time.monotonic_ns() >= deadline_ns:
            raise LinkError(f"node {waiting[0]} got the start command and is still {watches[waiting[0]].state}")
    for watch in watches.values():
        watch.run()
