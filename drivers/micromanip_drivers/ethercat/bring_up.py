"""From whatever state the line is in to one that operates: the steps in their order; longer ones have their own files.

A state is asked for and waited for, and a refusal told in words. Sync managers, FMMUs and watchdog of a terminal say
what lies where in its memory, and in the process image.
"""

from __future__ import annotations

import struct
import time

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

from .clocks import SYNC0_BEGINS_IN_S, Clocks, begin_sync0, require_clocks, set_clocks
from .image import Image, Placed
from .link import Link
from .mailbox import Mailbox
from .mapping import apply_mapping, require_mapping
from .options import EthercatOptions
from .scan import FIRST_STATION, Slave, require, reset

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
