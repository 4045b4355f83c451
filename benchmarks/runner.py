"""Runs the benchmarks that are asked for, one after the other; what they are told, and what they hand back."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, DeviceUnavailable, UsageError

NAMES = ("cycle", "lateness", "offline", "startup", "exchange")
"""Each is the module of that name with its function ``run``, imported only when it is used."""
Tell = Callable[[str], None]
"""Gets one line for people now and then."""
CONFIGURATION = Path(__file__).parents[1] / "config" / "paper.yaml"
PAIRS = 15
"""Interleaved pairs of ours and the reference in `cycle` and `lateness`."""


class Skipped(Exception):  # noqa: N818
    """Raised where the machine lacks what a benchmark needs; the text says what, and where to get it."""


@dataclass(frozen=True)
class Result:
    """One figure and its reference; `ratio` is a figure of its own where it is not just their quotient."""

    name: str
    value: float
    unit: str
    reference_name: str
    reference_value: float
    ratio: float

    @classmethod
    def of(cls, name: str, value: float, unit: str, reference_name: str, reference_value: float) -> Result:
        """The plain quotient as the ratio."""
        return cls(name, value, unit, reference_name, reference_value, value / reference_value)

    @classmethod
    def of_pairs(cls, name: str, pairs: NDArray[np.float64], unit: str, reference_name: str) -> Result:
        """Medians of figures that were taken in turns, (pairs, 2); the ratio is the median of the pairs' ratios."""
        value, reference = np.median(pairs, axis=0).tolist()
        return cls(name, value, unit, reference_name, reference, float(np.median(pairs[:, 0] / pairs[:, 1])))


def run(tell: Tell, only: tuple[str, ...] = ()) -> dict[str, list[dict[str, Any]]]:
    """Results of all benchmarks, or of those named, four digits each; what this machine can't run, and what was wrong.

    One that finds the controller itself wrong has failed; the others go on. Raises UsageError for an unknown name.
    """
    for name in only:
        if name not in NAMES:
            raise UsageError(f"there is no benchmark {name}; there are {', '.join(NAMES)}")
    document: dict[str, list[dict[str, Any]]] = {"results": [], "skipped": [], "failed": []}
    for name in only or NAMES:
        tell(name)
        try:
            for result in importlib.import_module(f"benchmarks.{name}").run(tell):
                document["results"].append({key: _rounded(value) for key, value in asdict(result).items()})
        except (
            Skipped,
            DeviceUnavailable,
            CheckFailed,
            AssertionError,
        ) as problem:  # on the bench something never came
            outcome = "skipped" if isinstance(problem, Skipped | DeviceUnavailable) else "failed"
            tell(f"{name}: {outcome}: {problem}")
            document[outcome].append({"name": name, "reason": str(problem)})
    return document


def _rounded(value: Any) -> Any:
    return float(f"{value:.4g}") if isinstance(value, float) else value
