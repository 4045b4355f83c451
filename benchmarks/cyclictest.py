"""Wake-up lateness as the usual tool sees it: ``cyclictest`` of Debian's package rt-tests."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from pathlib import Path

from micromanip.errors import DeviceUnavailable

_LONGEST_NS = 1_000_000
"""Its histogram ends here; what is later counts as its maximum."""


def require_cyclictest() -> str:
    """Path of the program; raises DeviceUnavailable where it is not installed."""
    program = shutil.which("cyclictest")
    if program is None:
        raise DeviceUnavailable("there is no cyclictest; install Debian package rt-tests")
    return program


def measure(period_ns: int, priority: int, cpu: int, seconds: float) -> dict[int, int]:
    """Counts by lateness (ns) over `seconds` of one thread; raises DeviceUnavailable where it may not run."""
    program = require_cyclictest()
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [program, "--threads=1", f"--priority={priority}", f"--affinity={cpu}", "--mlockall", "--quiet"]
        command += [f"--interval={period_ns // 1000}", f"--duration={max(1, round(seconds))}s"]
        command += ["--nsecs", f"--histogram={_LONGEST_NS}", f"--histfile={folder}/histogram", f"--json={report}"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0 or not report.is_file():
            said = (done.stderr or done.stdout).strip().splitlines() or [f"exit code {done.returncode}"]
            raise DeviceUnavailable(f"cyclictest does not run here: {said[-1]}")
        return _counts(json.loads(report.read_text(encoding="utf-8")))


def _counts(report: dict[str, dict[str, dict[str, dict[str, int]]]]) -> dict[int, int]:
    thread = report["thread"]["0"]
    counts = {int(lateness): count for lateness, count in thread["histogram"].items()}
    beyond = int(str(thread["cycles"])) - sum(counts.values())
    if beyond > 0:
        latest = int(str(thread["max"]))
        counts[latest] = counts.get(latest, 0) + beyond
    return counts


def percentile(counts: dict[int, int], fraction: float) -> float:
    """Smallest lateness (ns) that at least `fraction` of all wake-ups do not exceed."""
    wanted, seen = fraction * sum(counts.values()), 0
    for lateness in sorted(counts):
        seen += counts[lateness]
        if seen >= wanted:
            return float(lateness)
    raise DeviceUnavailable("cyclictest counted no wake-up")
