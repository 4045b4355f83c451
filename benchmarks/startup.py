"""From the command to READY, with and without compiled code at hand, its memory, and how soon a command answers.

The yardstick is a Python that does nothing but import numba and numpy; for a command, one that imports click.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from campaigns.running_controller import MICROMANIP, Running
from micromanip.errors import CheckFailed

from .runner import CONFIGURATION, Result, Tell

_WARM_RUNS = 5
_PYTHON, _CLICK = "import numba, numpy", "import click"
_COMMANDS = {"help": ("--help", 0), "status": ("status --socket /nowhere", 69)}
"""What is typed, and its exit code: no controller answers there."""


def run(tell: Tell) -> list[Result]:
    """Seconds to READY, cold once and warm as a median; peak megabytes of host and loop process."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tell("startup: cold, everything is compiled")
        cold_s, *_ = _start(folder)
        tell(f"startup: {_WARM_RUNS} times warm")
        pairs = [(_start(folder), _taken(sys.executable, "-c", _PYTHON)) for _ in range(_WARM_RUNS)]
    warm_s, host_mb, loop_mb = np.median([started for started, _ in pairs], axis=0).tolist()
    imports_s, imports_mb = np.median([imported for _, imported in pairs], axis=0).tolist()
    tell(f"startup: {_WARM_RUNS} times each command that only asks")
    click_s = _median_s(sys.executable, "-c", _CLICK)
    imports, click = f'python -c "{_PYTHON}"', f'python -c "{_CLICK}"'
    return [
        Result.of("startup_cold", cold_s, "s", imports, imports_s),
        Result.of("startup_warm", warm_s, "s", imports, imports_s),
        Result.of("memory_host", host_mb, "MB", imports, imports_mb),
        Result.of("memory_loop", loop_mb, "MB", imports, imports_mb),
        *(
            Result.of(f"startup_{name}", _median_s(str(MICROMANIP), *line.split(), code=code), "s", click, click_s)
            for name, (line, code) in _COMMANDS.items()
        ),
    ]


def _start(folder: Path) -> tuple[float, float, float]:
    """Seconds to READY, and the most memory (MB) that host and loop process have had by then."""
    begin = time.perf_counter()
    cache = ("env", f"XDG_CACHE_HOME={folder / 'cache'}")
    text = CONFIGURATION.read_text(encoding="utf-8").replace("arm_on_start: true", "arm_on_start: false")
    running = Running(folder, text, prefix=cache)
    try:
        running.reach("READY")
        seconds = time.perf_counter() - begin
        host_mb, loop_mb = (_peak_mb(pid) for pid in (running.process.pid, running.loop))
        if code := running.end():
            raise CheckFailed(f"micromanip run ended with {code}: {running.said}")
        return seconds, host_mb, loop_mb
    finally:
        running.kill()
        running.release()


def _peak_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii").split()
    return int(status[status.index("VmHWM:") + 1]) / 1024


def _taken(*command: str, code: int = 0) -> tuple[float, float]:
    """Wall time (s) and peak memory (MB) of a command that must end with `code`."""
    begin = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, ended, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(ended)
    if process.returncode != code:
        raise CheckFailed(f"{' '.join(command)} ended with {process.returncode}")
    return time.perf_counter() - begin, usage.ru_maxrss / 1024


def _median_s(*command: str, code: int = 0) -> float:
    return float(np.median([_taken(*command, code=code)[0] for _ in range(_WARM_RUNS)]))
