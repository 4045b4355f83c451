"""Distributed clocks of a line: the way to each slave measured, clocks set to the first one's, SYNC0 (ETG.1000.4)."""

from __future__ import annotations

import struct
import time
from collections.abc import Sequence

from micromanip.driver import DeviceFault
from micromanip.driver.ethercat import registers

from .link import Link

_SINCE_2000_S = 946_684_800
"""EtherCAT counts from the year 2000."""
_DC = 0x04
"""Feature bit of a slave that has a clock."""
_LONGEST_NS = 1_000_000
"""A line that takes longer has a slave that says rubbish."""
SYNC0_BEGINS_IN_S = 0.2
"""Surely later than the last of its registers is written, and SAFEOP reached."""


def set_clocks(link: Link, stations: Sequence[int]) -> tuple[int, int] | None:
    """Write offset and delay of each slave that has a clock; None where none has.

    Returns the station of the first of them, and how long (ns) a frame takes from there to the last slave and
    back, 0 where that isn't known.

    The first slave passes a frame on at its port 1 and gets it back there: what lies between is twice the way to the
    last. For slave k, delay = (what lies between at the reference - the same at slave k) / 2, which holds for a line
    without branches.
    """
    with_clock = [station for station in stations if link.station_read(station, registers.FEATURES, 1)[0] & _DC]
    if not with_clock:
        return None
    link.write(registers.BWR, 0, registers.DC_PORTS, bytes(4))
    now_ns = time.time_ns() - _SINCE_2000_S * 1_000_000_000
    latched = [struct.unpack("<II", link.station_read(station, registers.DC_PORTS, 8)) for station in with_clock]
    local = [struct.unpack("<q", link.station_read(station, registers.DC_UNIT, 8))[0] for station in with_clock]
    for station, ports, local_ns in zip(with_clock, latched, local, strict=True):
        delay_ns = max(0, (_between(latched[0]) - _between(ports)) // 2)
        offset_ns = now_ns + delay_ns - local_ns
        link.station_write(station, registers.DC_OFFSET, struct.pack("<q", offset_ns))
        link.station_write(station, registers.DC_DELAY, struct.pack("<I", delay_ns))
    turn_ns = _between(latched[0])
    return with_clock[0], turn_ns if turn_ns < _LONGEST_NS else 0


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
