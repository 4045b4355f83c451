"""From whatever state the line is in to one that operates: the steps in their order; longer ones have their own files.

A state is asked for and waited for, and a refusal told in words. Sync managers, FMMUs and watchdog of a terminal say
what lies where in its memory, and in the process image.
"""

from __future__ import annotations

import contextlib
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from micromanip.driver import DeviceFault, IdentityMismatch, LinkError
from micromanip.driver.ethercat import (
    ERROR,
    OP,
    PREOP,
    SAFEOP,
    STATE_MASK,
    STATE_NAMES,
    al_code_in_words,
    registers,
    state_name,
)

from .image import Image, Placed
from .link import Link
from .mailbox import Mailbox, apply_mapping, require_mapping
from .options import EthercatOptions
from .scan import FIRST_STATION, Slave, require, reset

_SINCE_2000_S = 946_684_800
"""EtherCAT counts from the year 2000."""
_DC = 0x04
"""Feature bit of a slave that has a clock."""
_LONGEST_NS = 1_000_000
"""A line that takes longer has a slave that says rubbish."""
_WHOLE_AGAIN_S = 2.0
"""A port that was closed for a second is surely open again."""
SYNC0_BEGINS_IN_S = 0.2
"""Surely later than the last of its registers is written, and SAFEOP reached."""


@dataclass(frozen=True)
class Clocks:
    """Of all slaves that have one, by their stations: the way (ns) to each from the first of them.

    `turn_ns` is how long a frame takes from there to the last slave and back, 0 where that isn't known.
    """

    delay_ns: dict[int, int]
    turn_ns: int

    def follow(self, link: Link, stations: Sequence[int]) -> None:
        """Let these follow the first of them, which is told by nobody: the way to each counts from there."""
        first_ns = self.delay_ns[stations[0]]
        for station in stations:
            link.station_write(station, registers.DC_DELAY, struct.pack("<I", self.delay_ns[station] - first_ns))


def set_clocks(link: Link, stations: Sequence[int]) -> Clocks:
    """Write offset and delay of each slave that has a clock, and empty the filters of its drift compensation.

    The first slave passes a frame on at its port 1 and gets it back there: what lies between is twice the way to the
    last. For slave k, delay = (what lies between at the reference - the same at slave k) / 2, which holds for a line
    without branches. A ring is one for as long as that takes.
    """
    with_clock = [station for station in stations if link.station_read(station, registers.FEATURES, 1)[0] & _DC]
    if not with_clock:
        return Clocks({}, 0)
    with _turned_back(link, stations[-1]):
        now_ns = time.time_ns() - _SINCE_2000_S * 1_000_000_000
        link.write(registers.BWR, 0, registers.DC_PORTS, bytes(4))
    latched = [struct.unpack("<II", link.station_read(station, registers.DC_PORTS, 8)) for station in with_clock]
    local = [struct.unpack("<q", link.station_read(station, registers.DC_UNIT, 8))[0] for station in with_clock]
    delays = [max(0, (_between(latched[0]) - _between(ports)) // 2) for ports in latched]
    for station, delay_ns, local_ns in zip(with_clock, delays, local, strict=True):
        link.station_write(station, registers.DC_OFFSET, struct.pack("<q", now_ns + delay_ns - local_ns))
        link.station_write(station, registers.DC_DELAY, struct.pack("<I", delay_ns))
        begin = link.station_read(station, registers.DC_SPEED_START, 2)
        link.station_write(station, registers.DC_SPEED_START, begin)
    turn_ns = _between(latched[0])
    return Clocks(dict(zip(with_clock, delays, strict=True)), turn_ns if turn_ns < _LONGEST_NS else 0)


@contextlib.contextmanager
def _turned_back(link: Link, last: int) -> Iterator[None]:
    """Let the last slave of a ring turn frames back: only so its slaves see at port 1 how long they take.

    It closes its port for a second only, so that a ring whose master died meanwhile is whole again by itself.
    """
    if not link.is_ring:
        yield
        return
    loops = link.station_read(last, registers.DL_CONTROL + 1, 1)[0]
    closed = bytes((registers.DL_RULES | registers.DL_FOR_A_SECOND, loops & ~registers.PORT1 | registers.PORT1_CLOSED))
    link.station_write(last, registers.DL_CONTROL, closed)
    try:
        yield
    finally:
        link.station_write(last, registers.DL_CONTROL, bytes((registers.DL_RULES, loops)))
        end = time.monotonic() + _WHOLE_AGAIN_S
        while link.read(registers.BRD, 0, registers.ESC_TYPE, 1) and link.open_behind is not None:
            if time.monotonic() > end:
                raise LinkError(f"{link.name}: the last slave does not open its port again, closed to measure the ring")


def require_clocks(link: Link, clocks: Clocks, stations: Sequence[int], names: Sequence[str]) -> None:
    """Raises DeviceFault where the first terminal has no clock, which all that have one are told by; of a ring, any."""
    needed = stations if link.is_ring else stations[:1]
    for name, station in zip(names, needed, strict=False):
        if station not in clocks.delay_ns:
            why = "a ring's clocks need one in each" if link.is_ring else "the first, which the others would follow,"
            raise DeviceFault(f"{link.name}: terminal {name} has no clock: {why}: say clocks: false")


def begin_sync0(link: Link, station: int, name: str, period_ns: int, shift_ns: int) -> None:
    """Let a terminal, whose clock is set, make SYNC0 `shift_ns` after each whole period of the clocks' time.

    Raises DeviceFault where it has no clock.
    """
    if not link.station_read(station, registers.FEATURES, 1)[0] & _DC:
        raise DeviceFault(f"{link.name}: terminal {name} has no clock, so no SYNC0: sync0_shift_us: null")
    link.station_write(station, registers.DC_ACTIVATE, b"\0")
    link.station_write(station, registers.DC_CONTROL, b"\0")
    (now_ns,) = struct.unpack("<q", link.station_read(station, registers.DC_SYSTEM, 8))
    start_ns = (now_ns + round(1e9 * SYNC0_BEGINS_IN_S)) // period_ns * period_ns + shift_ns
    link.station_write(station, registers.DC_START, struct.pack("<q", start_ns))
    link.station_write(station, registers.DC_SYNC0_CYCLE, struct.pack("<I", period_ns))
    link.station_write(station, registers.DC_ACTIVATE, bytes([registers.SYNC_ON | registers.SYNC0_ON]))


def _between(ports: tuple[int, int]) -> int:
    """Ns from passing a frame on to getting it back; 0 at the last slave, which has nothing at port 1."""
    there, back = ports
    return (back - there) % 2**32 if back else 0


_MAILBOX_OUT, _MAILBOX_IN = 0x26, 0x22
"""Control bytes of the sync managers."""
_READ, _WRITE = 1, 2
_TICKS_PER_MS = 10


def open_mailboxes(link: Link, slave: Slave) -> None:
    """Sync managers 0 and 1."""
    for k, (area, control) in enumerate(((slave.mailbox_out, _MAILBOX_OUT), (slave.mailbox_in, _MAILBOX_IN))):
        if area is not None:
            _manage(link, slave.station, k, *area, control)


def lay_out(link: Link, slave: Slave, placed: Placed) -> None:
    """The sync manager of each direction, and an FMMU for it, so that the process image finds its terminal.

    Whole bytes, which every FMMU can do; digital terminals have no more FMMUs than they need (decision 0050).
    """
    areas = (
        (slave.outputs, placed.outputs_at, placed.output_bytes, _WRITE),
        (slave.inputs, placed.inputs_at, placed.input_bytes, _READ),
    )
    used = [area for area in areas if area[2] > 0]
    for k, (area, logical, length, kind) in enumerate(used):
        _manage(link, slave.station, area.manager, area.start, length, area.control)
        fmmu = struct.pack("<IHBBHBBB3x", logical, length, 0, 7, area.start, 0, kind, 1)
        link.station_write(slave.station, registers.FMMU + k * registers.FMMU_BYTES, fmmu)


def set_watchdog(link: Link, station: int, watchdog_ms: float) -> None:
    """The time without outputs after which the slave leaves OP by itself."""
    link.station_write(station, registers.WATCHDOG_DIVIDER, struct.pack("<H", registers.WATCHDOG_DEFAULT_DIVIDER))
    link.station_write(station, registers.WATCHDOG_SM, struct.pack("<H", round(_TICKS_PER_MS * watchdog_ms)))


def _manage(link: Link, station: int, k: int, start: int, length: int, control: int) -> None:
    data = struct.pack("<HHBBBB", start, length, control, 0, 1, 0)
    link.station_write(station, registers.SM + k * registers.SM_BYTES, data)


_PATIENCE_S = 3.0
"""For a state that was asked for."""


def bring_to_safeop(link: Link, options: EthercatOptions, image: Image, period_ns: int) -> Clocks:
    """INIT, scan and compare, clocks, PREOP, settings and mapping, SAFEOP. No output moves.

    Returns what is known of the clocks.

    Raises LinkError, IdentityMismatch, DeviceFault.
    """
    reset(link)
    slaves = require(link, options.terminals)
    clocks = Clocks({}, 0)
    if options.clocks:
        stations = [slave.station for slave in slaves]
        clocks = set_clocks(link, stations)
        require_clocks(link, clocks, stations, list(options.terminals))
    for slave, (name, terminal) in zip(slaves, options.terminals.items(), strict=True):
        open_mailboxes(link, slave)
        go(link, slave.station, name, PREOP)
        if slave.mailbox_out is not None:
            mailbox = Mailbox(link, slave, name)
            for setting in terminal.settings.values():
                mailbox.write(setting.index, setting.subindex, setting.data)
            apply_mapping(mailbox, name, "outputs", terminal.outputs)
            apply_mapping(mailbox, name, "inputs", terminal.inputs)
        else:
            if terminal.settings:
                raise IdentityMismatch(f"{link.name}: terminal {name} has no mailbox to write its settings by")
            require_mapping(name, "outputs", terminal.outputs, slave.output_pdos)
            require_mapping(name, "inputs", terminal.inputs, slave.input_pdos)
        lay_out(link, slave, image.placed[name])
        if terminal.outputs and options.watchdog is not None and options.watchdog.ms is not None:
            set_watchdog(link, slave.station, options.watchdog.ms)
        if terminal.sync0_shift_us is not None:
            begin_sync0(link, slave.station, name, period_ns, round(1e3 * terminal.sync0_shift_us))
        go(link, slave.station, name, SAFEOP)
    if any(terminal.sync0_shift_us is not None for terminal in options.terminals.values()):
        time.sleep(SYNC0_BEGINS_IN_S)  # OP is refused before
    return clocks


def bring_to_op(link: Link, options: EthercatOptions) -> None:
    """SAFEOP to OP, while the loop sends the safe values in every cycle. Raises LinkError, DeviceFault."""
    for k, name in enumerate(options.terminals):
        go(link, FIRST_STATION + k, name, OP)


def go(link: Link, station: int, name: str, state: int) -> None:
    """Bring a slave to a state that it can reach in one step; any error is acknowledged first.

    Raises DeviceFault where it refuses, LinkError where nothing happens.
    """
    acknowledge = _status(link, station)[0] & ERROR
    link.station_write(station, registers.AL_CONTROL, struct.pack("<H", state | acknowledge))
    end = time.monotonic() + _PATIENCE_S
    while True:
        now, code = _status(link, station)
        if now == state:
            return
        if now & ERROR and (code or now & STATE_MASK != state):
            raise DeviceFault(
                f"{link.name}: terminal {name} refuses {STATE_NAMES[state]} and is in {state_name(now)}: "
                f"{al_code_in_words(code)} (0x{code:04x})"
            )
        if time.monotonic() > end:
            raise LinkError(f"{link.name}: terminal {name} stays in {state_name(now)}, {STATE_NAMES[state]} was asked")


def _status(link: Link, station: int) -> tuple[int, int]:
    """AL status and its code."""
    found = struct.unpack("<H2xH", link.station_read(station, registers.AL_STATUS, 6))
    return found[0] & (STATE_MASK | ERROR), found[1]
