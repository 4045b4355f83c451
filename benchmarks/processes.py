"""A command under observation: when it says something, and how much memory it and its children took at most."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from micromanip.errors import CheckFailed

COMMAND = "import sys; from micromanip.cli.main import main; sys.exit(main())"
_LOOK_S = 0.02


@dataclass(frozen=True)
class Observed:
    """What one run of a command showed."""

    seconds: float
    """From its start to the line waited for."""
    peak_mb: dict[int, float]
    """Most resident memory (MB) of each process from that line on, the command itself first."""


def observe(arguments: list[str], line: str, cache: Path) -> Observed:
    """Run ``micromanip ARGUMENTS`` until it ends, with its compiled code in `cache`; wait for `line` on standard error.

    Raises CheckFailed where it ends otherwise than with 0, or never says the line.
    """
    begin = time.perf_counter()
    environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-c", COMMAND, *arguments]
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        said = []
        for heard in process.stderr:
            said.append(heard)
            if heard.strip() == line:
                break
        seconds = time.perf_counter() - begin
        peaks: dict[int, float] = {}
        while process.poll() is None:
            for pid in (process.pid, *children(process.pid)):
                peaks[pid] = max(resident_mb(pid), peaks.get(pid, 0.0))
            time.sleep(_LOOK_S)
        said.append(process.stderr.read())
        if process.returncode != 0 or line not in map(str.strip, said):
            raise CheckFailed(f"micromanip {' '.join(arguments)} ended with {process.returncode}: {''.join(said)}")
    return Observed(seconds, peaks)


def reference(program: str, arguments: Sequence[str] = (), code: int = 0) -> tuple[float, float]:
    """Wall time (s) and peak resident memory (MB) of ``python -c PROGRAM ARGUMENTS``, which must end with `code`."""
    begin = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-c", program, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, ended, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(ended)
    if process.returncode != code:
        raise CheckFailed(f"python -c {program!r} ended with {process.returncode}")
    return time.perf_counter() - begin, usage.ru_maxrss / 1024


def children(pid: int) -> list[int]:
    """Processes that any thread of `pid` has started and that still run."""
    found: list[int] = []
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found += map(int, file.read_text().split())
        except OSError:
            continue  # the thread has ended
    return found


def resident_mb(pid: int) -> float:
    """Resident memory of a process; 0 where it has ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    for line in status.splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    return 0.0
