"""Runs the benchmarks that are asked for, one after the other."""

from __future__ import annotations

import importlib

from micromanip.errors import CheckFailed, DeviceUnavailable, UsageError

from .plan import Plan
from .results import Report, Skipped

NAMES = (
    "cycle",
    "cycle_laws",
    "lateness",
    "offline",
    "startup",
    "hysteresis_gradient",
    "can_frames",
    "can_worker",
    "line_rates",
    "modbus_transactions",
    "ethercat_exchange",
)
"""Each is the module of that name with its function ``run``, imported only when it is used."""


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
