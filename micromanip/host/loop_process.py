"""The loop process: maps the memory, opens the drivers, warms up, goes real-time, runs the loop.

Started by the host as ``python -m micromanip.host.loop_process`` in a session of its own, so that Ctrl-C
reaches the host only. It takes its orders as one JSON document on standard input.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.bus.bridge import bridge_functions
from micromanip.bus.cyclic import CyclicDriver, Functions
from micromanip.bus.registry import driver_class
from micromanip.errors import DeviceUnavailable, MicromanipError, PermissionDenied
from micromanip.rt.intrinsics import call_context
from micromanip.rt.loop import run_loop
from micromanip.rt.mailbox import FINISHED, RIGHTS
from micromanip.rt.records import CELL_STATE, DRIVER
from micromanip.rt.states import ARM, READY
from micromanip.rt.telemetry import ROW
from micromanip.rt.virtual import run_virtual

from .control.socket_file import remove_stale
from .realtime import enter_real_time, missing_rights
from .shared_memory import CONTROL, RING, STATUS, Segments

_WARM_CYCLES = 3000


def _drivers(orders: dict[str, Any], segments: Segments) -> tuple[Any, list[tuple[str, int, int]]]:
    """Driver records with addresses of this process, and what to close again: (name, function, context)."""
    base = segments.contexts.bytes().ctypes.data
    records = np.zeros(max(1, len(orders["drivers"])), DRIVER)
    opened = []
    for record, entry in zip(records, orders["drivers"], strict=False):
        functions = _functions(entry, orders["period_ns"])
        context = base + entry["context"]
        code = call_context(functions.open, context)
        if code != 0:
            raise DeviceUnavailable(f"driver {entry['name']} could not be opened: code {code}")
        opened.append((entry["name"], functions.close, context))
        record["exchange"], record["context"] = functions.exchange, context
        record["first_input"], record["first_output"] = entry["first_input"], entry["first_output"]
    return records, opened


def _functions(entry: dict[str, Any], period_ns: int) -> Functions:
    if entry["bus"]:  # its driver is the worker's: none of it is loaded here
        return bridge_functions()
    kind = driver_class(entry["driver"])
    assert issubclass(kind, CyclicDriver)
    return kind(kind.Options.model_validate_json(entry["options"]), period_ns).functions()


def _warm(control: Any, status: Any, samples: Any) -> None:
    """Run the cycle on copies, so that its code and the machine's caches are hot before the first deadline."""
    state = np.zeros(1, CELL_STATE)
    state[0]["state"] = READY
    signals = np.zeros_like(status["signals"])
    signals["sequence"] = 1
    rows = np.zeros(16, ROW)
    parameters = control["parameters"][:1].copy()
    parameters["axis"]["strain_age_ns"] = parameters["axis"]["stage_age_ns"] = np.iinfo(np.int64).max
    drivers = np.zeros(1, DRIVER)
    run_virtual(
        parameters, state, drivers, 0, signals, status["outputs"].copy(), samples.copy(), rows, _WARM_CYCLES, 10, ARM, 1
    )


def main() -> int:
    """Run the loop; the exit code is 0 after a clean end, else as in ``micromanip.errors``."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    orders = json.load(sys.stdin)
    segments = Segments.attach(orders["descriptors"], writable=True)
    control, status, ring = segments.control.record(CONTROL), segments.status.record(STATUS), segments.ring.record(RING)
    samples = segments.sample_table()
    try:
        drivers, opened = _drivers(orders, segments)
        _warm(control, status, samples)
        segments.ring.bytes()[::4096] = 0
        rights = enter_real_time(orders["cpu"], orders["priority"])
        if rights and orders["refuse_without_rights"]:
            raise PermissionDenied("; ".join(missing_rights(rights)))
    except MicromanipError as problem:
        sys.stderr.write(f"{problem}\n")
        return problem.exit_code
    words = status["words"]
    words[RIGHTS] = rights
    status["state"][0]["state"] = READY
    for i in range(control["parameters"][0]["axes"]):
        status["state"][0]["axis"][i]["voltage_V"] = control["parameters"][0]["axis"][i]["limiter"]["park_V"]
        status["outputs"][control["parameters"][0]["axis"][i]["voltage"]] = status["state"][0]["axis"][i]["voltage_V"]
    run_loop(
        control["words"],
        control["parameters"],
        words,
        status["state"],
        status["shadow"],
        status["snapshot"],
        drivers,
        len(opened),
        status["signals"],
        status["outputs"],
        samples,
        ring["words"],
        ring["rows"],
        status["lateness"],
        status["compute"],
        status["timespec"],
        orders["spin_ns"],
    )
    for _name, close, context in opened:
        call_context(close, context)
    words[FINISHED] = 1
    if os.getppid() != orders["host"]:
        remove_stale(Path(orders["socket"]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
