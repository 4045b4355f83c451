"""A slave controller (ESC): what its hardware does as a frame passes (``frame.py``), in compiled code.

It is read and written in its memory, maps logical addresses by its FMMUs, guards the mailboxes by its sync managers,
and latches times. Whatever needs thought is left to the slave's application (``application.py``) as an event. FMMUs map
bits or bytes; of a byte of the process data that an FMMU writes in part the other bits stay, as real ones do it with
digital outputs only.

What it lacks of a real one: the three buffers of a sync manager (a frame passes as a whole, so nothing is torn), two
logical areas in one FMMU, commands that read and write the same registers (APRW, FPRW, BRW), SYNC signals and latch
inputs, the host's side of the EEPROM, loops that are set for a second only, and those of other ports than port 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from micromanip.bus.ethercat.registers import (
    AL_CONTROL,
    DC_DELAY,
    DC_DIFFERENCE,
    DC_OFFSET,
    DC_PORTS,
    DC_SYSTEM,
    DC_UNIT,
    DL_CONTROL,
    FMMU,
    FMMU_BYTES,
    LRD,
    LRW,
    LWR,
    SII_CONTROL,
    SM,
    SM_ACTIVATE,
    SM_BYTES,
    SM_CONTROL,
    SM_FROM_MASTER,
    SM_FULL,
    SM_MAILBOX,
    SM_PDI,
    SM_STATUS,
    SM_WATCHDOG,
    WATCHDOG_DIVIDER,
    WATCHDOG_SM,
    WATCHDOG_STATUS,
    WATCHDOG_TICK_NS,
)
from micromanip.rt.record import record
from micromanip.rt.signatures import array_of

from ..compiled import compiled

MEMORY_BYTES = 0x3000
FMMU_COUNT, SM_COUNT = 8, 8
AL_ASKED, SII_ASKED, MAIL_CAME, MAIL_TAKEN, SM_CHANGED, LOOPS_SET, WATCHDOG_TURNED = 1, 2, 4, 8, 16, 32, 64
"""Events for the application."""
_DRIFT_SHIFT = 4
"""A slave's clock makes up for a 16th of the difference to the reference clock each time that it is told."""

ESC = record(
    ("memory", "u1", (MEMORY_BYTES,)),
    ("writable", "u1", (MEMORY_BYTES,)),
    ("powered", "i8"),
    ("events", "i8"),
    ("begun", "i8"),
    ("outputs_ns", "i8"),
    ("outputs_count", "i8"),
    ("output_manager", "i8"),
    ("clock_began_ns", "i8"),
    ("clock_ppb", "i8"),
    ("clock_adjusted_ns", "i8"),
    ("to_ns", "i8"),
    ("back_ns", "i8"),
    ("returns", "i8"),
    ("last_wkc", "i8"),
)
"""One controller. Where `writable` is 1 a master may write. Its clock began at `clock_began_ns`, gains `clock_ppb` and
was adjusted by so much. ``begun`` has a bit for each sync manager of whose mailbox the first byte has passed, and the
last not yet. A frame reaches it `to_ns` after the first one and, where `returns` is 1, comes by again
`back_ns` after that. `outputs_count` frames have brought outputs, to the sync manager `output_manager`, the last one
at `outputs_ns`."""


@compiled
def has_events(slaves: Any) -> bool:
    """Whether any application that has power has something to do."""
    events = 0
    for k in range(len(slaves)):
        events |= slaves[k]["events"] if slaves[k]["powered"] != 0 else 0
    return events != 0


@compiled
def number(data: Any, at: int, size: int) -> int:
    """An unsigned number of at most 7 bytes, or a signed one of 8."""
    found = np.int64(0)
    for i in range(size):
        found |= np.int64(data[at + i]) << (8 * i)
    return found  # type: ignore[return-value]


@compiled
def put_number(data: Any, at: int, size: int, value: int) -> None:
    """Write the lowest bytes of `value`."""
    for i in range(size):
        data[at + i] = np.uint8((value >> (8 * i)) & 0xFF)


@compiled
def local_ns(s: Any, now_ns: int) -> int:
    """The controller's own clock."""
    passed, ppb = now_ns - s["clock_began_ns"], s["clock_ppb"]
    whole_s, rest_ns = passed // 1_000_000_000, passed % 1_000_000_000  # their product alone is no int64 after a day
    return passed + whole_s * ppb + rest_ns * ppb // 1_000_000_000


@compiled
def system_ns(s: Any, now_ns: int) -> int:
    """Its copy of the time that all clocks share."""
    return local_ns(s, now_ns) + number(s["memory"], DC_OFFSET, 8) + s["clock_adjusted_ns"]


@compiled
def latch(s: Any, now_ns: int) -> None:
    """Keep the times at which this frame comes to each port."""
    there, back = local_ns(s, now_ns), local_ns(s, now_ns + s["back_ns"])
    put_number(s["memory"], DC_PORTS, 4, there)
    put_number(s["memory"], DC_PORTS + 4, 4, back if s["returns"] != 0 else 0)
    put_number(s["memory"], DC_UNIT, 8, there)


@compiled
def follow_clock(s: Any, reference_ns: int, now_ns: int) -> None:
    """The reference clock has said its time: come nearer to it."""
    ahead = system_ns(s, now_ns) - (reference_ns + number(s["memory"], DC_DELAY, 4))
    put_number(s["memory"], DC_DIFFERENCE, 4, min(abs(ahead), 0x7FFFFFFF) | (0 if ahead >= 0 else 0x80000000))
    s["clock_adjusted_ns"] -= ahead >> _DRIFT_SHIFT


@compiled
def guard_of(s: Any, start: int, length: int) -> int:
    """The sync manager that guards any of these bytes; -1 if none does."""
    m = s["memory"]
    for k in range(SM_COUNT):
        at = SM + k * SM_BYTES
        first, size = number(m, at, 2), number(m, at + 2, 2)
        if m[at + SM_ACTIVATE] & 1 != 0 and start < first + size and first < start + length:
            return k
    return -1


@compiled
def may_pass(s: Any, start: int, length: int, writing: bool) -> bool:
    """Whether the sync manager of these bytes lets the master at them, this way and now.

    A mailbox is written and read from its first byte to its last, in as many strokes as the master likes.
    """
    k = guard_of(s, start, length)
    if k < 0:
        return True
    m, at = s["memory"], SM + k * SM_BYTES
    for_writing = m[at + 4] & SM_FROM_MASTER != 0
    if for_writing != writing or m[at + SM_PDI] & 1 != 0:
        return False
    if m[at + 4] & SM_MAILBOX == 0:
        return True
    full = m[at + SM_STATUS] & SM_FULL != 0
    return full != writing and (start <= number(m, at, 2) or s["begun"] & (1 << k) != 0)


@compiled
def has_passed(s: Any, start: int, length: int, writing: bool, now_ns: int) -> None:
    """The last byte of a sync manager's area hands it over."""
    k = guard_of(s, start, length)
    if k < 0:
        return
    m, at = s["memory"], SM + k * SM_BYTES
    s["begun"] |= 1 << k
    if start + length < number(m, at, 2) + number(m, at + 2, 2):
        return
    s["begun"] &= ~(1 << k)
    if m[at + 4] & SM_MAILBOX != 0:
        if writing:
            m[at + SM_STATUS] |= np.uint8(SM_FULL)
            s["events"] |= MAIL_CAME
        else:
            m[at + SM_STATUS] &= np.uint8(0xFF ^ SM_FULL)
            s["events"] |= MAIL_TAKEN
    elif writing:
        s["outputs_ns"] = now_ns
        s["outputs_count"] += 1


@compiled
def write(s: Any, start: int, data: Any, at: int, length: int, now_ns: int) -> int:
    """Take bytes of a datagram into the memory: 1 where any of them may be written."""
    if start + length > MEMORY_BYTES or not may_pass(s, start, length, True):
        return 0
    m, taken = s["memory"], 0
    for i in range(length):
        if s["writable"][start + i] != 0:
            m[start + i] = data[at + i]
            taken = 1
    end = start + length
    if start <= AL_CONTROL < end:
        s["events"] |= AL_ASKED
    if start <= DL_CONTROL + 1 < end:
        s["events"] |= LOOPS_SET
    if start <= SII_CONTROL + 1 < end:
        s["events"] |= SII_ASKED
    if start < SM + SM_COUNT * SM_BYTES and end > SM:
        s["events"] |= SM_CHANGED
        s["begun"] = 0
    if start <= DC_PORTS < end:
        latch(s, now_ns)
        taken = 1
    if start == DC_SYSTEM and length >= 4:
        told, mask = number(data, at, length), -1 if length >= 8 else (1 << 8 * length) - 1
        near = system_ns(s, now_ns)
        follow_clock(s, told if length >= 8 else (near & ~mask) | told, now_ns)
        taken = 1
    has_passed(s, start, length, True, now_ns)
    return taken


@compiled
def read(s: Any, start: int, data: Any, at: int, length: int, merged: bool, now_ns: int) -> int:
    """Put bytes of the memory into a datagram, or merge them by `or`: 1 where they may be read."""
    if start + length > MEMORY_BYTES or not may_pass(s, start, length, False):
        return 0
    m = s["memory"]
    if start < DC_SYSTEM + 8 and start + length > DC_SYSTEM:
        put_number(m, DC_SYSTEM, 8, system_ns(s, now_ns))
    for i in range(length):
        data[at + i] = data[at + i] | m[start + i] if merged else m[start + i]
    has_passed(s, start, length, False, now_ns)
    return 1


@compiled
def map_bits(s: Any, f: int, logical: int, data: Any, at: int, length: int, writing: bool, now_ns: int) -> int:
    """What the FMMU at `f` does that begins or ends within a byte: 1 where it has any of these bits."""
    m = s["memory"]
    begin, physical = 8 * number(m, f, 4), 8 * number(m, f + 8, 2) + (m[f + 10] & 7)
    first, last = begin + (m[f + 6] & 7), begin + 8 * (number(m, f + 4, 2) - 1) + (m[f + 7] & 7)
    low, high = max(first, 8 * logical), min(last, 8 * (logical + length) - 1)
    if low > high:
        return 0
    start, end = (physical + low - first) >> 3, ((physical + high - first) >> 3) + 1
    if end > MEMORY_BYTES or not may_pass(s, start, end - start, writing):
        return 0
    for place in range(low, high + 1):
        inside, outside = physical + place - first, 8 * (at - logical) + place
        if not writing:
            copy_bit(m, inside, data, outside)
        elif s["writable"][inside >> 3] != 0:
            copy_bit(data, outside, m, inside)
    has_passed(s, start, end - start, writing, now_ns)
    return 1


@compiled
def copy_bit(source: Any, there: int, target: Any, here: int) -> None:
    """Bit number `there` of some bytes to number `here` of others, whose other bits stay."""
    bit = (source[there >> 3] >> (there & 7)) & 1
    mask = np.uint8(1 << (here & 7))
    target[here >> 3] = target[here >> 3] | mask if bit != 0 else target[here >> 3] & ~mask


@compiled
def map_logical(s: Any, command: int, logical: int, data: Any, at: int, length: int, now_ns: int) -> int:
    """What the FMMUs do with a logical datagram; by how much the working counter grows."""
    m, taken, put = s["memory"], 0, 0
    for reading in range(2):  # what is read replaces what is written: writing comes first
        if (reading == 1 and command == LWR) or (reading == 0 and command == LRD):
            continue
        for k in range(FMMU_COUNT):
            f = FMMU + k * FMMU_BYTES
            if m[f + 12] & 1 == 0 or m[f + 11] & (1 if reading == 1 else 2) == 0:
                continue
            if m[f + 6] & 7 != 0 or m[f + 7] & 7 != 7 or m[f + 10] & 7 != 0:
                if reading == 1:
                    put |= map_bits(s, f, logical, data, at, length, False, now_ns)
                else:
                    taken |= map_bits(s, f, logical, data, at, length, True, now_ns)
                continue
            first, physical = number(m, f, 4), number(m, f + 8, 2)
            low, high = max(first, logical), min(first + number(m, f + 4, 2), logical + length)
            if low >= high:
                continue
            if reading == 1:
                put |= read(s, physical + low - first, data, at + low - logical, high - low, False, now_ns)
            else:
                taken |= write(s, physical + low - first, data, at + low - logical, high - low, now_ns)
    return put + (2 if command == LRW else 1) * taken


_STOOD_NS = 10_000_000


@compiled
def has_run_out(s: Any, now_ns: int) -> bool:
    """Whether its sync manager is watched and has had no outputs for longer than the registers say."""
    m = s["memory"]
    unit_ns = (number(m, WATCHDOG_DIVIDER, 2) + 2) * WATCHDOG_TICK_NS
    patience_ns = number(m, WATCHDOG_SM, 2) * unit_ns
    watched = m[SM + s["output_manager"] * SM_BYTES + SM_CONTROL] & SM_WATCHDOG
    return watched != 0 and patience_ns > 0 and now_ns - s["outputs_ns"] > patience_ns


@compiled
def watch(slaves: Any, awake_ns: int, now_ns: int) -> None:
    """Tell each application whose watchdog runs out, or no longer has. This process went on last at `awake_ns`."""
    stood_ns = now_ns - awake_ns if now_ns - awake_ns > _STOOD_NS else 0
    for k in range(len(slaves)):
        s = slaves[k]
        s["outputs_ns"] += stood_ns
        if s["powered"] != 0 and has_run_out(s, now_ns) == (s["memory"][WATCHDOG_STATUS] & 1 != 0):
            s["events"] |= WATCHDOG_TURNED


@compiled.entry(types.boolean(array_of(ESC), types.int64, types.int64))
def pass_time(slaves: Any, awake_ns: int, now_ns: int) -> bool:
    """Watchdogs while no frame comes: whether any application has something to do."""
    watch(slaves, awake_ns, now_ns)
    return has_events(slaves)
