"""From whatever state the line is in to one that operates: the steps in their order, each in a file of its own."""

from __future__ import annotations

import time

from micromanip.driver.ethercat import OP, PREOP, SAFEOP

from .clocks import SYNC0_BEGINS_IN_S, Clocks, begin_sync0, require_clocks, set_clocks
from .drive_objects import prepare_drive
from .image import Image
from .link import Link
from .mailbox import Mailbox
from .mapping import apply_mapping
from .memory import lay_out, open_mailboxes, set_watchdog
from .options import EthercatOptions
from .scan import FIRST_STATION, require, reset
from .states import go


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
            if terminal.drive is not None:
                prepare_drive(mailbox, f"{link.name}: terminal {name}", terminal.drive)
        lay_out(link, slave, image.placed[name])
        if terminal.outputs and options.watchdog is not None:
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
