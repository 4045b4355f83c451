"""Faults in plain words: code, what was seen, likely causes, next step.

The texts are in ``faults.toml``; ``docs/faults.md`` is generated from them.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

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


def _table() -> dict[str, FaultText]:
    data = tomllib.loads((files("micromanip.host") / "faults.toml").read_text(encoding="utf-8"))
    return {name: FaultText(**entry | {"likely_causes": tuple(entry["likely_causes"])}) for name, entry in data.items()}


_TABLE = _table()
LOOP_DIED, LOOP_STUCK = _TABLE.pop("LOOP_DIED"), _TABLE.pop("LOOP_STUCK")
"""What only the host can see."""
FAULTS = {int(getattr(states, name)): text for name, text in _TABLE.items()}
"""Faults and warnings that the loop raises, by their number in ``states``."""
ALL = tuple(sorted((*FAULTS.values(), LOOP_DIED, LOOP_STUCK), key=lambda text: text.code))


def fault_message(
    fault: int, axis: str | None, value: float, limit: float = math.nan, drivers: Sequence[str] = ()
) -> str:
    """One line for people: code, where, what, likely causes, next step.

    Of a lost link, and of outputs that were taken away, `value` is the number of its driver among `drivers`.
    """
    text = FAULTS[fault]
    where = f"axis {axis}" if axis else None
    if fault in (states.LINK_LOST, states.OUTPUTS_TAKEN) and drivers:
        where = f"driver {drivers[int(value)]}"
    return f"{seen(text, value, limit, where)}. {advice(text)}"


def code_of(message: str) -> str:
    """The code that a message about a fault begins with."""
    return message.split(" ", 1)[0]


def seen(text: FaultText, value: float, limit: float, where: str | None = None) -> str:
    """Code, where, and what was seen."""
    return f"{text.code} {where + ': ' if where else ''}{text.what.format(value=value, limit=limit)}"


def advice(text: FaultText) -> str:
    """Likely causes and next step, in two sentences."""
    return f"Likely: {'; or '.join(text.likely_causes)}. {text.next_step}"
