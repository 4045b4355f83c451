"""Faults in plain words: code, what was seen, likely cause, next step."""

from __future__ import annotations

from dataclasses import dataclass

from micromanip.rt import states


@dataclass(frozen=True)
class FaultText:
    """Message of one fault; `what` takes the value that was seen."""

    code: str
    what: str
    next_step: str


FAULTS = {
    states.HOST_DEAD: FaultText(
        "X-101",
        "no sign of life from the host process for {value:.0f} ms",
        "See the system log for why it died; start again.",
    ),
    states.OVERRUNS: FaultText(
        "X-102",
        "{value:.0f} deadlines missed in a row",
        "Another process, an interrupt or power saving delays the loop's CPU: see the real-time set-up in the README.",
    ),
    states.DRIVER_ERROR: FaultText(
        "X-103", "a driver failed in the loop with code {value:.0f}", "See the driver's manual."
    ),
    states.STRAIN_INVALID: FaultText(
        "X-201", "no usable strain-gauge sample for {value:.0f} cycles", "Check the gauge, its cable and the bus."
    ),
    states.STAGE_INVALID: FaultText(
        "X-202", "no usable capacitive sample for {value:.0f} cycles", "Check the sensor's gap, its cable and the bus."
    ),
    states.NOT_FINITE: FaultText(
        "X-203",
        "the control law gave no finite set-point (last good one {value:.2f} um)",
        "Check the outer loop's model.",
    ),
}


def fault_message(fault: int, axis: str | None, value: float) -> str:
    """One line for people: where, code, what, next step."""
    text = FAULTS[fault]
    where = f"axis {axis}: " if axis else ""
    return f"{text.code} {where}{text.what.format(value=value)}. {text.next_step}"
