"""A fault, a record from the loop to whoever shows it: screen, journal, black box, JSON.

The loop latches numbers; `latched` and `raised` read them into a `FaultReport`. Text is made of it, ``str(report)``,
only where somebody reads it. The words stand in ``faults.toml``; ``docs/faults.md`` is generated from them.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from micromanip.rt import states
from micromanip.status_reply import Fault

_WORDS = Path(__file__).with_name("faults.toml")
"""By the file: where a process begins in a folder that has another one called ``micromanip``, the name finds that."""


@dataclass(frozen=True)
class FaultKind:
    """All that is known of a fault or a warning (W) before it happens."""

    name: str
    """As in ``micromanip.rt.states``."""
    code: str
    what: str
    """What was seen, with places for `value` (measured) and `limit`, both in the fault's own unit."""
    detection: str
    """What is watched, and how long it must last; with places for the keys of `section`."""
    reaction: str
    """What is done; with places for the keys of `section`."""
    likely_causes: tuple[str, ...]
    next_step: str
    section: str = ""
    """Section of the configuration below ``faults`` that has its limits."""

    @property
    def number(self) -> int | None:
        """As in ``micromanip.rt.states``; None of what only the host can see."""
        return getattr(states, self.name, None)

    @property
    def is_warning(self) -> bool:
        """Whether it is only told, never latched."""
        return self.number is not None and self.number >= states.FAULTS


def _table() -> dict[str, FaultKind]:
    data = tomllib.loads(_WORDS.read_text(encoding="utf-8"))
    return {
        name: FaultKind(**entry | {"name": name, "likely_causes": tuple(entry["likely_causes"])})
        for name, entry in data.items()
    }


BY_NAME = _table()
LOOP_DIED, LOOP_STUCK = BY_NAME["LOOP_DIED"], BY_NAME["LOOP_STUCK"]
"""What only the host can see."""
KINDS = {number: kind for kind in BY_NAME.values() if (number := kind.number) is not None}
"""Faults and warnings that the loop raises, by their number in ``states``."""


@dataclass(frozen=True)
class FaultReport:
    """One fault that happened."""

    kind: FaultKind
    axis: str | None = None
    """None for the whole cell."""
    value: float = math.nan
    limit: float = math.nan
    cycle: int | None = None
    """The cycle in which it was noticed, where that is known."""
    driver: str | None = None
    """Whose link or outputs were lost."""
    what: str = ""
    """What was seen, where the kind's own sentence does not fit."""
    explained: bool = True
    """Whether the kind's causes and next step fit what was seen."""
    box: str | None = None
    """File of its black box, once it is on disk."""

    @property
    def seen(self) -> str:
        """Code, where, and what was seen."""
        where = f"driver {self.driver}: " if self.driver else f"axis {self.axis}: " if self.axis else ""
        return f"{self.kind.code} {where}{self.measured}"

    @property
    def measured(self) -> str:
        """What was seen, with its figures."""
        return self.what or self.kind.what.format(value=self.value, limit=self.limit)

    def __str__(self) -> str:
        """For people: what was seen, likely causes, next step, black box."""
        likely = f"Likely: {'; or '.join(self.kind.likely_causes)}. {self.kind.next_step}"
        told = f"{self.seen}. {likely}" if self.explained else self.seen
        return f"{told} Black box: {self.box}" if self.box else told

    def document(self) -> Fault:
        """As JSON; a figure that is unknown, or no number, is None."""
        return {
            "code": self.kind.code,
            "name": self.kind.name,
            "axis": self.axis,
            "driver": self.driver,
            "value": self.value if math.isfinite(self.value) else None,
            "limit": self.limit if math.isfinite(self.limit) else None,
            "cycle": self.cycle,
            "seen": self.seen,
            "likely_causes": list(self.kind.likely_causes) if self.explained else [],
            "next_step": self.kind.next_step if self.explained else "",
        }


def latched(state: Any, axes: Sequence[str], drivers: Sequence[str]) -> list[FaultReport]:
    """Every fault that is latched in the loop's `state`, the one that ends the run last; at most two."""
    reports = []
    for name in ("former", "fault"):
        if state[name] != states.NO_FAULT:
            cycle = int(state["fault_cycle"]) if name == "fault" else None
            place, value, limit = state[f"{name}_axis"], state[f"{name}_value"], state[f"{name}_limit"]
            reports.append(_report(state[name], place, value, limit, cycle, axes, drivers))
    return reports


def raised(event: Any, axes: Sequence[str], drivers: Sequence[str] = ()) -> FaultReport | None:
    """One entry of the loop's list of events; None where this version does not know its number."""
    if int(event["code"]) not in KINDS:
        return None
    return _report(event["code"], event["axis"], event["value"], event["limit"], int(event["cycle"]), axes, drivers)


def _report(
    number: int, place: int, value: float, limit: float, cycle: int | None, axes: Sequence[str], drivers: Sequence[str]
) -> FaultReport:
    """Of a lost link, and of outputs that were taken away, `value` is the number of its driver."""
    is_of_driver = number in (states.LINK_LOST, states.OUTPUTS_TAKEN) and 0 <= value < len(drivers)
    return FaultReport(
        KINDS[int(number)],
        axes[int(place)] if 0 <= place < len(axes) else None,
        float(value),
        float(limit),
        cycle,
        drivers[int(value)] if is_of_driver else None,
    )
