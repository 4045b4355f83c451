"""Do two replays agree? Every number of their states, outputs and telemetry rows is compared."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

from .recording import Outcome

TOLERANCE = 1e-9
"""Of the largest value that the number takes, at least of 1 um or 1 V; whole numbers must be equal."""
_SCRATCH = ("scratch",)  # working memory of one function, no state
_TOLD = ("events", "event")  # the list for the host; what is raised stands in the conditions, which are compared


def require_agreement(a: Outcome, b: Outcome) -> None:
    """Raise CheckFailed, naming field and cycle, where `a` and `b` differ by more than `TOLERANCE`."""
    for part in ("rows", "state", "outputs"):
        for name, left, right in _numbers(part, getattr(a, part), getattr(b, part)):
            _require_close(name, left, right)


def _numbers(name: str, a: NDArray[Any], b: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any], NDArray[Any]]]:
    if a.dtype.names is None:
        yield name, a, b
        return
    for field in a.dtype.names:
        if field not in _SCRATCH + _TOLD:
            yield from _numbers(f"{name}.{field}", a[field], b[field])


def _require_close(name: str, a: NDArray[Any], b: NDArray[Any]) -> None:
    if np.issubdtype(a.dtype, np.integer):
        differs = a != b
    else:
        scale = max(1.0, float(np.max(np.abs(a[np.isfinite(a)]), initial=0.0)))
        differs = ~np.isclose(a, b, rtol=0.0, atol=TOLERANCE * scale, equal_nan=True)
    if differs.any():
        place = tuple(int(i) for i in np.argwhere(differs)[0])
        raise CheckFailed(
            f"our cycle and its C twin disagree: {name} at {list(place)} is {a[place]!r} and {b[place]!r}, "
            f"{np.count_nonzero(differs)} of {differs.size} numbers differ"
        )
