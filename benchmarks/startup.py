"""From the command to READY, with and without compiled code at hand, its memory, and how soon a command answers.

The yardstick is a Python that does nothing but import numba and numpy; for a command, one that imports click.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from .processes import COMMAND, Observed, observe, reference
from .runner import Plan, Result

_WARM_RUNS = 5
_IMPORTS = "import numba, numpy"
_REFERENCE = f'python -c "{_IMPORTS}"'
_CLICK = "import click"
_COMMANDS = {"help": ("--help", 0), "status": ("status --socket /nowhere", 69)}
"""What is typed, and its exit code: no controller answers there."""


def run(plan: Plan) -> list[Result]:
    """Seconds to READY, cold once and warm as a median; peak megabytes of host and loop process."""
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder) / "cache"
        arguments = ["run", str(plan.configuration), "--duration", "0.1", "--socket", str(Path(folder) / "socket")]

        def start() -> Observed:
            return observe(arguments, "READY", cache)

        plan.tell("startup: cold, everything is compiled")
        cold = start()
        plan.tell(f"startup: {_WARM_RUNS} times warm")
        pairs = [(start(), reference(_IMPORTS)) for _ in range(_WARM_RUNS)]
    imports_s, imports_mb = np.median([figures for _, figures in pairs], axis=0).tolist()
    warm_s = float(np.median([started.seconds for started, _ in pairs]))
    host_mb, loop_mb = list(pairs[-1][0].peak_mb.values())[:2]
    plan.tell(f"startup: {_WARM_RUNS} times each command that only asks")
    click_s = float(np.median([reference(_CLICK)[0] for _ in range(_WARM_RUNS)]))
    commands = [
        Result.of(f"startup_{name}", _answer_s(*command), "s", f'python -c "{_CLICK}"', click_s)
        for name, command in _COMMANDS.items()
    ]
    return [
        Result.of("startup_cold", cold.seconds, "s", _REFERENCE, imports_s),
        Result.of("startup_warm", warm_s, "s", _REFERENCE, imports_s),
        Result.of("memory_host", host_mb, "MB", _REFERENCE, imports_mb),
        Result.of("memory_loop", loop_mb, "MB", _REFERENCE, imports_mb),
        *commands,
    ]


def _answer_s(line: str, code: int) -> float:
    return float(np.median([reference(COMMAND, line.split(), code)[0] for _ in range(_WARM_RUNS)]))
