"""The loop process: maps the memory, opens the drivers, warms up, goes real-time, runs the loop.

Started by the host as ``python -m micromanip.host.loop_process`` in a session of its own, so that Ctrl-C
reaches the host only. It imports before it gets its orders, with the shared memory (``shared_memory.py``).
"""

# ruff: noqa: E402
from __future__ import annotations

import gc

gc.disable()  # of all that is imported here nothing is garbage, and the loop makes none: a fifth of the start

import contextlib
import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.bus.bridge import bridge_functions
from micromanip.bus.cyclic import CyclicDriver, call_context
from micromanip.bus.errors import BusError
from micromanip.bus.registry import driver_class
from micromanip.errors import DeviceUnavailable, MicromanipError, PermissionDenied
from micromanip.rt.jit import Compiler, compiled, prepare
from micromanip.rt.loop import run_loop
from micromanip.rt.mailbox import COMMAND, COMMAND_NUMBER, FINISHED, HEARTBEAT_NS, RIGHTS
from micromanip.rt.records import DRIVER
from micromanip.rt.states import ARM, HOST_DEAD, RAMPS, READY

from .control.socket_file import remove_stale
from .realtime import enter_real_time, missing_rights
from .shared_memory import CONTROL, RING, STATUS, Segments, receive_orders

_WARM_CYCLES, _WARM_PERIOD_NS = 3000, 20_000


def _drivers(orders: dict[str, Any], segments: Segments) -> tuple[Any, list[tuple[str, int, int]], Any]:
    """Driver records with addresses of this process, what to close again (name, function, context), what steers."""
    base, steering_ns = segments.contexts.bytes().ctypes.data, np.zeros(1, np.int64)
    records = np.zeros(len(orders["drivers"]), DRIVER)
    opened = []
    for record, entry in zip(records, orders["drivers"], strict=True):
        driver = _driver(entry, orders["period_ns"])
        functions = bridge_functions() if driver is None else driver.functions()
        context = base + entry["context"]
        if driver is not None:
            block = segments.contexts.bytes()[entry["context"] :][: entry["context_bytes"]]
            _begin(entry["name"], driver, block)
            steering_ns = driver.steering_ns(block) if driver.steers else steering_ns
        code = call_context(functions.open, context)
        if code != 0:
            raise DeviceUnavailable(f"driver {entry['name']} could not be opened: code {code}")
        opened.append((entry["name"], functions.close, context))
        record["exchange"], record["context"] = functions.exchange, context
        record["first_input"], record["first_output"] = entry["first_input"], entry["first_output"]
    return records, opened, steering_ns


def _driver(entry: dict[str, Any], period_ns: int) -> CyclicDriver | None:
    """None for a bus: its driver is the worker's, and none of it is loaded here."""
    if entry["bus"]:
        return None
    kind = driver_class(entry["driver"])
    assert issubclass(kind, CyclicDriver)
    return kind(kind.Options.model_validate_json(entry["options"]), period_ns)


def _begin(name: str, driver: CyclicDriver, context: Any) -> None:
    try:
        driver.begin(context)
    except BusError as problem:
        raise DeviceUnavailable(f"driver {name} could not be opened: {problem}") from problem


def _warm(control: Any, samples: Any, spin_ns: int) -> None:
    """Run the loop on memory of its own, so that its code and the machine's caches are hot before the first deadline.

    It arms without drivers, in short periods that may be missed; once the sign of life is over it parks and ends.
    """
    own, status, ring = np.zeros(1, CONTROL), np.zeros(1, STATUS), np.zeros(1, RING)
    status[0]["state"]["state"], status[0]["signals"]["sequence"] = READY, 1
    own["parameters"][0, 0] = control["parameters"][0]
    p, words = own["parameters"][0, 0], own["words"][0]
    p["axis"]["strain_age_ns"] = p["axis"]["stage_age_ns"] = np.iinfo(np.int64).max
    p["period_ns"] = _WARM_PERIOD_NS
    p["overruns_in_a_row"], p["overrun_level"] = np.iinfo(np.int64).max, np.inf
    p["heartbeat_ns"] = p["hold_cycles"] = 0
    p["ramp_cycles"] = 1
    p["reaction"][HOST_DEAD] = RAMPS
    words[COMMAND], words[COMMAND_NUMBER] = ARM, 1
    words[HEARTBEAT_NS] = time.monotonic_ns() + _WARM_CYCLES * _WARM_PERIOD_NS
    run_loop(own, status, ring, np.zeros(0, DRIVER), samples, spin_ns, np.zeros(1, np.int64))


def _compile(orders: dict[str, Any]) -> None:
    """The loop, and on another CPU at the same time what the drivers have; both are in the cache from then on."""
    child = None if compiled.keeps(run_loop) else os.fork()
    if child != 0:
        prepare(run_loop)
        if child is not None:
            os.waitpid(child, 0)
        return
    with contextlib.suppress(OSError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
    try:
        for entry in orders["drivers"]:
            driver = _driver(entry, orders["period_ns"])
            bridge_functions() if driver is None else driver.functions()
    finally:  # what it could not do is done, and told, once more by its parent
        os._exit(0)


def _print(text: str) -> None:
    """A line for people: the host passes it on."""
    print(json.dumps({"text": text}), flush=True)  # noqa: T201


def main() -> int:
    """Run the loop; the exit code is 0 after a clean end, else as in ``micromanip.errors``."""
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):  # sent to all processes of a service
        signal.signal(number, signal.SIG_IGN)
    orders, descriptors = receive_orders()
    if orders is None:  # there will be no loop
        return 0
    segments = Segments.attach(descriptors, writable=True)
    control, memory, ring = (
        np.frombuffer(segment.memory, kind)
        for segment, kind in ((segments.control, CONTROL), (segments.status, STATUS), (segments.ring, RING))
    )
    status, parameters = memory[0], control[0]["parameters"][0]
    samples = segments.sample_table()
    Compiler.tell = staticmethod(lambda name: _print(f"compiling {name} for this processor, once after an update"))
    Compiler.tell_left = staticmethod(lambda name, seconds: _print(f"compiling {name}: {seconds:.0f} s left"))
    try:
        _compile(orders)
        drivers, opened, steering_ns = _drivers(orders, segments)
        _warm(control[0], samples, orders["spin_ns"])
        segments.ring.bytes()[::4096] = 0
        rights = enter_real_time(orders["cpu"], orders["priority"])
        if rights and orders["refuse_without_rights"]:
            raise PermissionDenied("; ".join(missing_rights(rights)))
    except MicromanipError as problem:
        sys.stderr.write(f"{problem}\n")
        return problem.exit_code
    gc.freeze()  # nor is anything garbage at the end, where Python would look through all of it: a tenth of a second
    words = status["words"]
    words[RIGHTS] = rights
    status["state"][0]["state"] = READY
    for i in range(parameters["axes"]):
        axis = parameters["axis"][i]
        status["state"][0]["axis"][i]["voltage_V"] = status["outputs"][axis["voltage"]] = axis["limiter"]["park_V"]
    run_loop(control, memory, ring, drivers, samples, orders["spin_ns"], steering_ns)
    for _name, close, context in opened:
        call_context(close, context)
    words[FINISHED] = 1
    if os.getppid() != orders["host"]:
        remove_stale(Path(orders["socket"]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
