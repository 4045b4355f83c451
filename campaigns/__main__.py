"""``python -m campaigns [NAME]``: run a campaign, or list them all.

Exit code 1 where something was not as it must be, 64 for a wrong command line.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

from .report import ROOT, Asked, Report


@dataclass(frozen=True)
class Campaign:
    """`does` in one line; `takes` is the usual duration of `count` cases on two cores.

    `command` is typed instead of a module's `run`, ``{count}`` filled in; `module` is that of another name.
    """

    does: str
    takes: str
    count: int = 0
    command: str = ""
    module: str = ""


_TESTS = f"env NUMBA_BOUNDSCHECK=1 {sys.executable} -m pytest -n0 --timeout=7200"
"""Compiled code checks its indices."""
_MACHINES = ROOT / "campaigns" / "machines"

CAMPAIGNS = {
    "devices": Campaign(
        "random commands, kills, cuts, bad files on devices with habits of their own; each voltage judged", "2 h", 100
    ),
    "faults": Campaign("faults of nine buses on the whole daemon, each noticed in time and undone", "15 min"),
    "robustness": Campaign("drawn plants commissioned; true margins beside those claimed", "25 min", 100),
    "foreign": Campaign(
        "plants of a class that the design does not know; their true margins", "25 min", 40, module="robustness"
    ),
    "accuracy": Campaign("path error and sines of our axes and of drawn plants, beside the bound", "15 min", 50),
    "tune": Campaign("commission config/factory.yaml; write the tuned configurations", "3 min"),
    "mutation": Campaign("each mutant of the last gates and of the fault manager must die", "10 min"),
    "machine": Campaign(
        "ten thousand commands, faults, lines and swaps on the cell in virtual time",
        "10 min",
        command=f"{_TESTS} --hypothesis-profile=soak tests/rt/test_cell_machine.py",
    ),
    "recorder": Campaign(
        "a recorder killed at random moments; its file is read each time",
        "5 min",
        100,
        command=f"{_TESTS} --kills {{count}} tests/host/test_mcap_recording.py",
    ),
    "fuzz": Campaign(
        "garbage at the control socket and at each driver",
        "2 h",
        1_000_000,
        f"{_TESTS} -k garbage --garbage {{count}} tests/host tests/drivers",
    ),
    "systemd": Campaign(
        "the service under a real systemd, on a throw-away copy of this machine; takes root",
        "5 min",
        command="{machines}/scenarios.sh namespace",
    ),
    "package": Campaign(
        "the Debian package from installing to a service that tracks, and back, with three cells; takes root",
        "50 min",
        command="{machines}/package.sh {only}",
    ),
    "vm": Campaign(
        "the service and SocketCAN on a PREEMPT_RT kernel, emulated; takes root, fetches 90 MB",
        "10 min",
        command="{machines}/scenarios.sh vm",
    ),
}


def main() -> int:
    """0 where all was as it must be."""
    parser = argparse.ArgumentParser(prog="python -m campaigns", description=__doc__)
    parser.add_argument("name", nargs="?", metavar="NAME", help="one of the list; without it, the list")
    parser.add_argument("--count", type=int, help="how many cases")
    parser.add_argument("--seed", type=int, default=1, help="what random cases follow from (1)")
    parser.add_argument("--bus", help="this bus only, where a campaign knows several")
    parser.add_argument("--only", default="", help="this case: a number, a module, or a regular expression of names")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time, where cases compute")
    parser.add_argument("--json", action="store_true", help="one document on standard output instead of the tables")
    parser.add_argument("--write", action="store_true", help="write docs/reports/NAME.md too")
    given = parser.parse_args(namespace=Asked())
    if given.name is None:
        print("".join(f"{name:15} {each.takes:>7}  {each.does}\n" for name, each in CAMPAIGNS.items()), end="")
        return 0
    if given.name not in CAMPAIGNS:
        print(f"there is no campaign {given.name}; there are {', '.join(CAMPAIGNS)}", file=sys.stderr)
        return 64
    chosen = CAMPAIGNS[given.name]
    given.count = chosen.count if given.count is None else given.count
    if chosen.command:
        line = chosen.command.format(count=given.count, only=given.only, machines=shlex.quote(str(_MACHINES)))
        return min(1, subprocess.run(shlex.split(line), cwd=ROOT, check=False).returncode)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # with all that was started brought to its end
    with tempfile.TemporaryDirectory(prefix=f"{given.name}-") as folder:
        given.folder = Path(folder)
        report: Report = importlib.import_module(f"campaigns.{chosen.module or given.name}").run(given)
    if not any(report.tables.values()):
        report.wrong.append(f"nothing was tried: no case is called {given.only}")
    print(json.dumps(asdict(report), indent=2, default=float) if given.json else report.text)
    if given.write:
        head = f"# Report: {given.name}\n\n{chosen.does[0].upper()}{chosen.does[1:]}. Written by"
        head += f" `make campaign NAME={given.name} ARGS=--write`, on {os.cpu_count()} CPUs.\n\n"
        (ROOT / "docs" / "reports" / f"{given.name}.md").write_text(head + report.text, encoding="utf-8")
    return 1 if report.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
