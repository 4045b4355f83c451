"""Sync managers, FMMUs and watchdog of a terminal: what lies where in its memory, and in the process image."""

from __future__ import annotations

import struct

from micromanip.driver.ethercat import registers

from .image import Placed
from .link import Link
from .scan import Slave

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

    Whole bytes, which every FMMU can do; digital terminals have no more FMMUs than they need (decision 0066).
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
