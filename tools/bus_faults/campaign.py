"""One daemon on one bus, one fault after the other; what is left behind at the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tools.own_shared_memory import own_shared_memory

from . import ethercat_cases
from .bench import WATCHDOG_MS, Bench, Outcome
from .cases import CAN, GCS, MODBUS, SERIAL, Case
from .cells import gcs_cell, modbus_cell, serial_cell, watched_can_cell
from .ethercat_cells import drive_cell, line_cell, ring_cell

BUSES: dict[str, tuple[Callable[[], str], tuple[Case, ...]]] = {
    "can": (watched_can_cell, CAN),
    "modbus": (modbus_cell, MODBUS),
    "serial": (serial_cell, SERIAL),
    "gcs": (gcs_cell, GCS),
    "ethercat": (line_cell, ethercat_cases.LINE),
    "ring": (ring_cell, ethercat_cases.RING),
    "drive": (drive_cell, ethercat_cases.DRIVE),
}
"""Examples of config/ and their faults; the last three have a cell of their own."""
TITLES = {
    "ethercat": "An axis on a line of three EtherCAT terminals, 500 Hz",
    "ring": "An axis on a ring of three EtherCAT terminals, 500 Hz",
    "drive": "An axis on a line with a drive (CiA 402) for an amplifier, 500 Hz",
}
"""Of those that are no example of config/."""

_CLOSING_S = 3.0


def _grown(bench: Bench, before: int) -> int:
    """How many descriptors more than `before` stay open: those of our own last calls are closed a moment later."""
    end = time.monotonic() + _CLOSING_S
    while (grown := bench.running.descriptors - before) > 0 and time.monotonic() < end:
        time.sleep(0.05)
    return grown


def campaign(folder: Path, text: str, cases: tuple[Case, ...], watchdog_ms: float = WATCHDOG_MS) -> Iterator[Outcome]:
    """Try each case on the configuration `text`, then end: processes, descriptors and shared memory that were left.

    Where the system gives them no shared memory of their own, it is not known whose any is, and said so.
    """
    prefix = own_shared_memory()
    bench = Bench(folder, text, watchdog_ms, prefix=prefix)
    code, left, shared = None, [], []
    try:
        shared = bench.shared_memory() if prefix else []
        bench.track()
        before = bench.running.descriptors
        for case in cases:
            yield bench.try_out(case)
        bench.rest()
        grown = _grown(bench, before)
    finally:
        code, played, left = bench.end()
    end = Outcome("the end")
    if (code, played) != (0, 0):
        end.wrong.append(f"daemon and device ended with {code} and {played}")
    if left:
        end.wrong.append(f"processes left: {left}")
    if grown > 0:
        end.wrong.append(f"the daemon has {grown} descriptors more than before")
    if kept := [name for each in shared for name in each.emptied()]:
        end.wrong.append(f"shared memory left: {kept}")
    if not prefix:
        end.note = "shared memory was not looked at: it has to be shared with others here"
    yield end
