"""The gate of a wire that the loop serves (``rt/io/link_gate.py``) in plain Python: set up, and told of."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from micromanip.rt.bus_image import OUTPUT_NAMES
from micromanip.rt.io.gate import SWITCH, VOLTAGE
from micromanip.rt.io.link_gate import ANSWERS, QUIET, RESTING

from .cyclic import Wire
from .safe_state import SafeOutput
from .watchdog import Watchdog


def close_gate(gate: Any, outputs: Sequence[tuple[float, bool]], silent_cycles: int, watchdog: Watchdog | None) -> None:
    """As before anything was sent; `outputs` are (safe value, whether a switch) each.

    `watchdog` is None for a device without outputs.
    """
    gate["state"], gate["outputs"], gate["silent_cycles"] = RESTING, len(outputs), silent_cycles
    gate["watchdog_ns"], gate["still_ns"] = np.iinfo(np.int64).max, 0
    gate["patient_cycles"] = silent_cycles
    if watchdog is not None:
        gate["watchdog_ns"] = round(watchdog.begins_ns)
        gate["still_ns"] = watchdog.still_ns
    for i, (safe, switch) in enumerate(outputs):
        gate["safe"][i] = gate["last"][i] = safe
        gate["kind"][i] = SWITCH if switch else VOLTAGE
        gate["step"][i] = math.inf if switch else 0.0  # until the limits are adopted


def adopt_limits(gate: Any, outputs: Sequence[SafeOutput], period_ns: int) -> None:
    """Take over how fast each voltage may change."""
    for i, output in enumerate(outputs):
        if gate["kind"][i] == VOLTAGE:
            gate["step"][i] = output.slew_V_per_s * period_ns * 1e-9


def gate_statistics(gate: Any) -> dict[str, int]:
    """What it has counted."""
    return {name: int(gate[name]) for name in ("unanswered", "refused_values", "held_back", "losses")}


def wire_of(gate: Any) -> Wire:
    """Where the wire stands."""
    sent_ns = int(gate["sent_ns"])
    silent = time.monotonic_ns() - sent_ns > int(gate["watchdog_ns"])  # no loop
    state = QUIET if silent else int(gate["state"])
    given = tuple(float(value) for value in gate["last"][: int(gate["outputs"][0])])
    up = state != QUIET and int(gate["answers"]) >= ANSWERS
    return Wire(up, OUTPUT_NAMES[state], given, sent_ns, int(gate["begun"]))


def wait_for_rest(gate: Any) -> None:
    """Until the device's watchdog has brought it to rest; nothing may be sent meanwhile."""
    until_ns = int(gate["sent_ns"]) + int(gate["still_ns"])
    time.sleep(max(0, until_ns - time.monotonic_ns()) * 1e-9)
