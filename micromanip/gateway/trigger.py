"""What a scope waits for, exact to the cycle: every row is looked at, in the precision of the ring."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import UsageError, did_you_mean
from micromanip.rt.states import NO_FAULT, STATE_NAMES

from .fields import Field
from .views import number

Kind = Literal["edge", "window", "state", "fault", "overrun"]
KINDS: tuple[Kind, ...] = ("edge", "window", "state", "fault", "overrun")
SLOPES = ("up", "down", "either")
_LARGEST = 1e30


@dataclass(frozen=True)
class Condition:
    """`edge`: a field passes `level`; `window`: it leaves `low` to `high`; `state`: the cell comes into `state`;
    `fault`: one is latched; `overrun`: the loop missed a deadline before this cycle.
    """

    kind: Kind
    field: Field | None = None
    level: float = 0.0
    slope: str = "up"
    low: float = -math.inf
    high: float = math.inf
    state: int = 0

    @classmethod
    def read(cls, query: Any, fields: Sequence[Field]) -> Self:
        """What a client asked for; UsageError where it makes no sense."""
        if not isinstance(query, dict) or query.get("kind") not in KINDS:
            raise UsageError(f"a trigger is one of {', '.join(KINDS)}")
        kind: Kind = query["kind"]
        if kind == "state":
            if query.get("state") not in STATE_NAMES:
                raise UsageError(f"a state is one of {', '.join(STATE_NAMES)}")
            return cls(kind, state=STATE_NAMES.index(query["state"]))
        if kind in ("fault", "overrun"):
            return cls(kind)
        named = {field.name: field for field in fields}
        name = query.get("field")
        if name not in named:
            raise UsageError(f"there is no field {name!r:.40}; {did_you_mean(str(name), named)}")
        if kind == "edge":
            slope = query.get("slope", "up")
            if slope not in SLOPES:
                raise UsageError(f"a slope is one of {', '.join(SLOPES)}")
            return cls(kind, named[name], level=number(query, "level", -_LARGEST, _LARGEST), slope=slope)
        low, high = (number(query, name, -_LARGEST, _LARGEST) for name in ("low", "high"))
        if low >= high:
            raise UsageError(f"a window has low < high, not {low:g} and {high:g}")
        return cls(kind, named[name], low=low, high=high)

    def hits(self, rows: NDArray[Any]) -> NDArray[np.intp]:
        """Which of `rows` fulfil it, and the row before did not; the first one has no row before it."""
        if self.kind == "overrun":
            found = rows["periods"][1:] > 1
        elif self.kind == "edge":
            assert self.field is not None
            found = _passes(self.field.of(rows), self.level, self.slope)
        else:
            is_so = self._is_so(rows)
            found = is_so[1:] & ~is_so[:-1]
        return np.flatnonzero(found) + 1

    def _is_so(self, rows: NDArray[Any]) -> NDArray[np.bool_]:
        if self.kind == "state":
            return np.asarray(rows["state"] == self.state)
        if self.kind == "fault":
            return np.asarray(rows["fault"] != NO_FAULT)
        assert self.field is not None
        values = self.field.of(rows)
        return np.asarray((values < self.low) | (values > self.high))


def _passes(values: NDArray[Any], level: float, slope: str) -> NDArray[np.bool_]:
    before, now = values[:-1], values[1:]
    up = (before < level) & (now >= level)
    down = (before > level) & (now <= level)
    return np.asarray({"up": up, "down": down, "either": up | down}[slope])


class Trigger:
    """Follows the rows; after a hit it waits until what comes after is there, and can then be armed again.

    `before` and `after` are cycles around the one that is hit. Modes: `single` stays with the first, `normal` goes on,
    `auto` lets the scope run freely where nothing comes for so long as its window, half a second at least.
    """

    def __init__(self, condition: Condition, mode: str, before: int, after: int, patience: int) -> None:
        if mode not in ("single", "normal", "auto"):
            raise UsageError("a trigger's mode is single, normal or auto")
        self._condition, self.mode = condition, mode
        self._before, self._after, self._patience = before, after, patience
        self.cycle: int | None = None
        """The cycle that was hit."""
        self._seen: NDArray[Any] | None = None
        self._newest = self._armed_at = self._not_before = -1

    def add(self, rows: NDArray[Any]) -> None:
        """New rows, oldest first."""
        if not len(rows):
            return
        if self._armed_at < 0:
            self._armed_at = int(rows["cycle"][0])
        self._newest = int(rows["cycle"][-1])
        if self.cycle is None:
            looked_at = rows if self._seen is None else np.concatenate([self._seen, rows])
            hits = looked_at["cycle"][self._condition.hits(looked_at)]
            hits = hits[hits > self._not_before]
            if len(hits):
                self.cycle = int(hits[0])
        self._seen = rows[-1:].copy()

    @property
    def window(self) -> tuple[int, int] | None:
        """First and last cycle around the hit, once all of it is there."""
        if self.cycle is None or self._newest < self.cycle + self._after:
            return None
        return self.cycle - self._before, self.cycle + self._after

    @property
    def runs_free(self) -> bool:
        """Whether `auto` has waited long enough."""
        return self.mode == "auto" and self.cycle is None and self._newest - self._armed_at >= self._patience

    def arm(self) -> None:
        """Wait for the next one; it comes after what was shown."""
        self._not_before = self._newest if self.cycle is None else self.cycle + self._after
        self._armed_at, self.cycle = self._newest, None
