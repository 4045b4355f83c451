"""Why arming, or a reset, was refused, in words: one sentence for each bit that the loop has set."""

from __future__ import annotations

from typing import Any

from micromanip.rt import states

_CELL = {
    states.NOT_READY: "the state is {state}: arming begins in READY, and goes on after a hold",
    states.LATCHED: "a fault is latched or the cell is stopping: `micromanip reset` once the cause is gone",
    states.ENABLE_MISSING: "the signal enable is not 1: is the emergency stop released?",
    states.LINK_MISSING: "the link to a bus is down: see `micromanip status`, it comes back by itself when it can",
    states.OUTPUTS_MISSING: "the outputs of a bus are not in the loop's hand yet, they are on their way to rest: see "
    "`micromanip status`",
    states.INTERLOCK_MISSING: "the signal interlock is not 1: is the guard closed?",
}
_AXIS = {
    states.STRAIN_MISSING: "strain_{axis} is not valid, or stuck: check the gauge and its cable",
    states.STAGE_MISSING: "stage_{axis} is silent, not a number, or stuck: check the capacitive sensor and its cable; "
    "if it is at the end of its range at rest, signals.stage_{axis}.range_um must say where that is",
    states.REFERENCE_MISSING: "deviation_{axis} is not fresh: does the tracker see its target?",
    states.AMPLIFIER_MISSING: "amplifier_ok_{axis} is not 1: look at the amplifier",
    states.TEMPERATURE_MISSING: "temperature_ok_{axis} is not 1: let the amplifier cool down",
    states.NOT_RESUMABLE: "axis {axis} is held with its voltage frozen: disarm it first",
}


def refusals(bits: int, state: str) -> list[str]:
    """Reasons of the cell."""
    return [text.format(state=state) for bit, text in _CELL.items() if bits & bit]


def output_refusals(cell: Any, state: str) -> list[str]:
    """Why `reset` can't lead to READY: that says of every output that it rests. `cell` is the loop's state."""
    bits = states.LINK_MISSING * int(cell["link_down"] != 0) | states.OUTPUTS_MISSING * int(cell["outputs_taken"] != 0)
    return refusals(bits, state)


def axis_refusals(bits: int, axis: str) -> list[str]:
    """Reasons of one axis."""
    return [text.format(axis=axis) for bit, text in _AXIS.items() if bits & bit]
