"""Faults in plain words: code, what was seen, likely causes, next step. ``docs/faults.md`` is generated from here."""

from __future__ import annotations

import math
from dataclasses import dataclass

from micromanip.rt import states


@dataclass(frozen=True)
class FaultText:
    """All that people are told of one fault."""

    code: str
    what: str
    """What was seen, with places for `value` (measured) and `limit`, both in the fault's own unit."""
    detection: str
    """What is watched, and how long it must last."""
    reaction: str
    """What is done unless the configuration says otherwise."""
    likely_causes: tuple[str, ...]
    next_step: str


FAULTS = {
    states.HOST_DEAD: FaultText(
        "X-101",
        "no sign of life from the host process for {value:.0f} ms",
        "The host's heartbeat is older than 100 ms (simulation: 1 s).",
        "Ramp to park, then OFF: the loop ends.",
        ("the host process was killed or crashed", "the machine was out of memory or heavily overloaded"),
        "See the system log for why it died; start again.",
    ),
    states.OVERRUNS: FaultText(
        "X-102",
        "{value:.0f} deadlines missed in a row",
        "Three deadlines missed in a row, also by one stall (simulation: never).",
        "Ramp to park.",
        ("another process, an interrupt or power saving delays the loop's CPU", "the machine has no real-time set-up"),
        "See the real-time set-up in the README.",
    ),
    states.DRIVER_ERROR: FaultText(
        "X-103",
        "a driver failed in the loop with code {value:.0f}",
        "A driver's exchange returned a code other than 0.",
        "Ramp to park.",
        ("the device lost its power or its connection", "the device reports an error of its own"),
        "See the driver's manual.",
    ),
    states.STRAIN_INVALID: FaultText(
        "X-201",
        "no usable strain-gauge sample for {value:.0f} cycles",
        "For 3 cycles the sample was not finite, flagged bad, outside `range_um`, or older than `max_age_us`.",
        "Ramp to park.",
        ("the gauge's cable or connector is loose", "its amplifier has no supply", "the bus is down or too slow"),
        "Check the gauge, its cable and the bus.",
    ),
    states.STAGE_INVALID: FaultText(
        "X-202",
        "no usable capacitive sample for {value:.0f} cycles",
        "As X-201, for the capacitive sensor and while the outer loop is closed.",
        "Ramp to park.",
        ("the stage is out of the sensor's range", "the sensor's gap is dirty", "its cable or the bus is interrupted"),
        "Check the sensor's gap, its cable and the bus.",
    ),
    states.NOT_FINITE: FaultText(
        "X-203",
        "the control law gave no finite set-point (last good one {value:.2f} um)",
        "In each cycle, before the set-point is used.",
        "Ramp to park.",
        ("the outer loop's model or gains are wrong", "a reference without bounds"),
        "Check the outer loop's model.",
    ),
}
"""Faults that the loop raises, by their number in ``states``."""

LOOP_DIED = FaultText(
    "X-104",
    "the loop process {how}",
    "The host waits for its child; where the host is dead too, the black box sees that no cycle passes any more.",
    "The host brings every output to its safe value through the driver, and ends.",
    ("it was killed, by hand or for want of memory", "a driver's library crashed"),
    "Look for the cause in the system log before you start again.",
)
LOOP_STUCK = FaultText(
    "X-105",
    "the loop has stood still for {value:.1f} s and is ended",
    "No cycle for 0.3 s (simulation: 2 s).",
    "The host kills the loop process; then as X-104.",
    ("a driver's exchange blocks", "the process was stopped", "the machine stalled"),
    "Look at the driver and at the system log before you start again.",
)

ALL = (*FAULTS.values(), LOOP_DIED, LOOP_STUCK)


def fault_message(fault: int, axis: str | None, value: float, limit: float = math.nan) -> str:
    """One line for people: code, where, what, likely causes, next step."""
    text = FAULTS[fault]
    return f"{seen(text, value, limit, axis)}. {advice(text)}"


def seen(text: FaultText, value: float, limit: float, axis: str | None = None) -> str:
    """Code, where, and what was seen."""
    where = f"axis {axis}: " if axis else ""
    return f"{text.code} {where}{text.what.format(value=value, limit=limit)}"


def advice(text: FaultText) -> str:
    """Likely causes and next step, in two sentences."""
    return f"Likely: {'; or '.join(text.likely_causes)}. {text.next_step}"
