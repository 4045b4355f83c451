"""From whatever state the line is in to one that operates: the steps in their order, each in a file of its own."""

from __future__ import annotations

import time

from micromanip.driver import DeviceFault
from micromanip.driver.ethercat import OP, PREOP, SAFEOP

from .clocks import SYNC0_BEGINS_IN_S, begin_sync0, set_clocks
from .image import Image
from .link import Link
from .mailbox import Mailbox
from .mapping import apply_mapping
from .memory import lay_out, open_mailboxes, set_watchdog
from .options import EthercatOptions
from .scan import FIRST_STATION, require, reset
from .states import go


def bring_to_safeop(link: Link, options: EthercatOptions, image: Image, period_ns: int) -> int:
    """INIT, scan and compare, clocks, PREOP, settings and mapping, SAFEOP. No output moves.

    Returns how long (ns) a frame takes from the first clock to the last slave and back, 0 where that isn't known.

    Raises LinkError, IdentityMismatch, DeviceFault.
    """
    reset(link)
    slaves = require(link, options.terminals)
    clocks = set_clocks(link, [slave.station for slave in slaves]) if options.clocks else None
    first_clock, turn_ns = (None, 0) if clocks is None else clocks
    if options.lock is not None and first_clock != FIRST_STATION:
        raise DeviceFault(f"{link.name}: terminal {next(iter(options.terminals))}, the first, has no clock to lock to")
    for slave, (name, terminal) in zip(slaves, options.terminals.items(), strict=True):
        open_mailboxes(link, slave)
        go(link, slave.station, name, PREOP)
        if slave.mailbox_out is not None:
            mailbox = Mailbox(link, slave, name)
            for setting in terminal.settings.values():
                mailbox.write(setting.index, setting.subindex, setting.data)
            apply_mapping(mailbox, name, "outputs", terminal.outputs)
            apply_mapping(mailbox, name, "inputs", terminal.inputs)
        lay_out(link, slave, image.placed[name])
        if terminal.outputs and options.watchdog is not None:
            set_watchdog(link, slave.station, options.watchdog.ms)
        if terminal.sync0_shift_us is not None:
            begin_sync0(link, slave.station, name, period_ns, round(1e3 * terminal.sync0_shift_us))
        go(link, slave.station, name, SAFEOP)
    if any(terminal.sync0_shift_us is not None for terminal in options.terminals.values()):
        time.sleep(SYNC0_BEGINS_IN_S)  # OP is refused before
    return turn_ns


def bring_to_op(link: Link, options: EthercatOptions) -> None:
    """SAFEOP to OP, while the loop sends the safe values in every cycle. Raises LinkError, DeviceFault."""
    for k, name in enumerate(options.terminals):
        go(link, FIRST_STATION + k, name, OP)
