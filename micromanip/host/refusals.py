"""Why the loop refused a command, in words: of arming and a reset one sentence for each bit that it has set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from micromanip.errors import CheckFailed
from micromanip.faults import FaultReport
from micromanip.rt import states
from micromanip.rt.states import STATE_NAMES
from micromanip.settings.schema.model import Configuration

_CELL = {
    states.NOT_READY: "the state is {state}: arming begins in READY, and goes on after a hold",
    states.LATCHED: "a fault is latched or the cell is stopping: `micromanip reset` once the cause is gone",
    states.ENABLE_MISSING: "the signal enable is not 1: is the emergency stop released?",
    states.LINK_MISSING: "the link to a bus is down: see `micromanip status`, it comes back by itself when it can",
    states.OUTPUTS_MISSING: "the outputs of a bus are not in the loop's hand yet, they are on their way to rest: see "
    "`micromanip status`",
    states.INTERLOCK_MISSING: "the signal interlock is not 1: is the guard closed?",
}
_LINES = {states.ENABLE_MISSING: "enable", states.INTERLOCK_MISSING: "interlock"}
_AXIS_LINES = {states.AMPLIFIER_MISSING: "amplifier_ok", states.TEMPERATURE_MISSING: "temperature_ok"}
_SENSORS = states.STRAIN_MISSING | states.STAGE_MISSING | states.REFERENCE_MISSING
_AWAY = "a device of a bus has not taken its safe values yet: see `micromanip status`"
_AXIS = {
    states.STRAIN_MISSING: "strain_{axis} is not valid, or stuck: check the gauge and its cable",
    states.STAGE_MISSING: "stage_{axis} is silent, not a number, or stuck: check the capacitive sensor and its cable; "
    "if it is at the end of its range at rest, signals.stage_{axis}.range_um must say where that is",
    states.REFERENCE_MISSING: "deviation_{axis} is not fresh: does the tracker see its target?",
    states.AMPLIFIER_MISSING: "amplifier_ok_{axis} is not 1: look at the amplifier",
    states.TEMPERATURE_MISSING: "temperature_ok_{axis} is not 1: let the amplifier cool down",
    states.NOT_RESUMABLE: "axis {axis} is held with its voltage frozen: disarm it first",
}


class Refused(CheckFailed):
    """The loop refused a command, and changed nothing."""

    def __init__(self, text: str, awaits: list[str] | None = None) -> None:
        """`awaits`: what an arming lacks, where that is nothing but samples which may yet come (`awaited`)."""
        super().__init__(text)
        self.awaits = awaits


def awaited(cell: Any, configuration: Configuration) -> list[str] | None:
    """What a refused arming lacks where time alone may mend it; None where anything else was in its way.

    A sensor may become valid. A line (enable, guard, amplifier) may have to say its first word; one that says 0, or has
    fallen silent, is somebody's no, and so is a fault, a link that was lost since READY, or any state but READY.
    """
    found = _comes_yet(int(cell["refused"]), cell, 0, _LINES)
    for i in range(len(configuration.axes)):
        refused = int(cell["arming"][i]["refused"])
        found &= _comes_yet(refused, cell["axis"][i], _SENSORS, _AXIS_LINES)
    return _arming(cell, STATE_NAMES[states.READY], configuration) if found else None


def _comes_yet(bits: int, state: Any, sensors: int, lines: Mapping[int, str]) -> bool:
    said_no = any(
        bits & bit and state[name]["time_ns"] != 0 and not (state[name]["bad"] == 0 and state[name]["value"] > 0.5)
        for bit, name in lines.items()
    )
    return not said_no and bits & ~(sensors | sum(lines)) == 0


def refusals(
    command: int, cell: Any, state: str, configuration: Configuration, faults: Sequence[FaultReport]
) -> list[str]:
    """Why the loop refused `command` in `state`; `cell` is its state, of `faults` the last counts."""
    if command == states.RESET and state == STATE_NAMES[states.FAULT] and (away := _outputs_away(cell, state)):
        return away
    if command in (states.BEGIN_PART, states.END_PART) and "part" in configuration.signals:
        return ["the signal part says which part is being made"]
    if command == states.END_PART and state == STATE_NAMES[states.TRACKING]:
        return ["none is being made"]
    reasons = [f"the state is {state}"]
    if command == states.ARM:
        reasons = _arming(cell, state, configuration)
    return [*reasons, *map(str, faults[-1:])]


def _arming(cell: Any, state: str, configuration: Configuration) -> list[str]:
    reasons = _of_the_cell(int(cell["refused"]), state)
    for i, name in enumerate(configuration.axes):
        bits = int(cell["arming"][i]["refused"])
        reasons += [text.format(axis=name) for bit, text in _AXIS.items() if bits & bit]
    return reasons


def _of_the_cell(bits: int, state: str) -> list[str]:
    return [text.format(state=state) for bit, text in _CELL.items() if bits & bit]


def _outputs_away(cell: Any, state: str) -> list[str]:
    """Why `reset` can't lead to READY: that says of every output that it rests."""
    bits = states.LINK_MISSING * int(cell["link_down"] != 0) | states.OUTPUTS_MISSING * int(cell["outputs_taken"] != 0)
    return _of_the_cell(bits, state) or ([_AWAY] if cell["outputs_away"] != 0 else [])
