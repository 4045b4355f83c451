"""Runs the benchmarks that are asked for, one after the other; what they are told, and what they hand back."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from micromanip.errors import CheckFailed, DeviceUnavailable, UsageError

NAMES = (
    "cycle",
    "cycle_laws",
    "lateness",
    "offline",
    "startup",
    "can_frames",
    "can_worker",
    "line",
    "modbus",
    "ethercat_exchange",
)
"""Each is the module of that name with its function ``run``, imported only when it is used."""


@dataclass(frozen=True)
class Plan:
    """Settings of all benchmarks."""

    configuration: Path
    pairs: int
    """Interleaved pairs of ours and the reference in `cycle` and `lateness`."""
    lateness_s: float
    """Length of one measurement of `lateness`."""
    tell: Callable[[str], None]
    """Gets one line for people now and then."""


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


@dataclass
class Report:
    """Everything that one ``micromanip system bench`` found out."""

    results: list[Result] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """As ``bench --json`` prints it, four digits."""
        return {
            "results": [{k: _rounded(v) for k, v in asdict(result).items()} for result in self.results],
            "skipped": [{"name": name, "reason": reason} for name, reason in self.skipped.items()],
            "failed": [{"name": name, "reason": reason} for name, reason in self.failed.items()],
        }


def _rounded(value: Any) -> Any:
    return float(f"{value:.4g}") if isinstance(value, float) else value


def run(plan: Plan, only: tuple[str, ...] = ()) -> Report:
    """All benchmarks, or only those named; in the report are also what this machine can't run, and what was wrong.

    One that finds the controller itself wrong has failed; the others go on. Raises UsageError for an unknown name.
    """
    for name in only:
        if name not in NAMES:
            raise UsageError(f"there is no benchmark {name}; there are {', '.join(NAMES)}")
    report = Report()
    for name in NAMES:
        if only and name not in only:
            continue
        plan.tell(name)
        try:
            report.results += importlib.import_module(f"benchmarks.{name}").run(plan)
        except (Skipped, DeviceUnavailable) as reason:
            plan.tell(f"{name}: skipped: {reason}")
            report.skipped[name] = str(reason)
        except CheckFailed as problem:
            plan.tell(f"{name}: failed: {problem}")
            report.failed[name] = str(problem)
    return report
