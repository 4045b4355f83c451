"""The gate of a wire that the loop serves (``rt/wire/gate.py``) in plain Python: set up, and told of."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from micromanip.rt.bus_image import FOLLOWING as OUTPUTS_FOLLOW
from micromanip.rt.bus_image import OUTPUT_NAMES
from micromanip.rt.bus_image import RESTING as OUTPUTS_REST
from micromanip.rt.bus_image import UNKNOWN as OUTPUTS_UNKNOWN
from micromanip.rt.wire.gate import ANSWERS, FOLLOWING, QUIET, RESTING

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
        gate["rest"][i], gate["switch"][i], gate["given"][i] = safe, switch, safe
        gate["step"][i] = math.inf if switch else 0.0  # until the limits are adopted


def adopt_limits(gate: Any, outputs: Sequence[SafeOutput], period_ns: int) -> None:
    """Take over how fast each voltage may change."""
    for i, output in enumerate(outputs):
        if not gate["switch"][i]:
            gate["step"][i] = output.slew_V_per_s * period_ns * 1e-9


def gate_statistics(gate: Any) -> dict[str, int]:
    """What it has counted."""
    return {name: int(gate[name]) for name in ("unanswered", "refused_values", "held_back", "losses")}


def wire_of(gate: Any) -> Wire:
    """Where the wire stands."""
    sent_ns = int(gate["sent_ns"])
    quiet = int(gate["state"]) == QUIET or time.monotonic_ns() - sent_ns > int(gate["watchdog_ns"])  # or no loop
    follows = OUTPUTS_FOLLOW if int(gate["state"]) == FOLLOWING else OUTPUTS_REST
    given = tuple(float(value) for value in gate["given"][: gate["outputs"]])
    up = not quiet and int(gate["answers"]) >= ANSWERS
    return Wire(up, OUTPUT_NAMES[OUTPUTS_UNKNOWN if quiet else follows], given, sent_ns, int(gate["begun"]))


def wait_for_rest(gate: Any) -> None:
    """Until the device's watchdog has brought it to rest; nothing may be sent meanwhile."""
    until_ns = int(gate["sent_ns"]) + int(gate["still_ns"])
    time.sleep(max(0, until_ns - time.monotonic_ns()) * 1e-9)
