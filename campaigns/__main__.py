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
from dataclasses import dataclass
from pathlib import Path

from .report import ROOT, Asked, Report

REPORTS = ROOT / "docs" / "reports"


@dataclass(frozen=True)
class Campaign:
    """`does` in one line; `takes` is the usual duration of `count` cases on two cores.

    `command` is typed instead of a module's `run`, ``{count}`` filled in.
    """

    does: str
    takes: str
    count: int = 0
    command: str = ""


def _tests(arguments: str) -> str:
    """A long run of tests."""
    return f"{sys.executable} -m pytest -n0 --timeout=7200 {arguments}"


_CHECKED = "env NUMBA_BOUNDSCHECK=1 "
"""With bounds checks in compiled code."""
_FRAMES = "tests/drivers/ethercat/test_garbage.py --garbage {count}"
_WORKERS = "tests/drivers/canopen/test_garbage.py tests/drivers/line/test_garbage.py --garbage {count}"
_PACKAGE = shlex.quote(str(ROOT / "campaigns" / "machines" / "package.sh"))
_MACHINE = shlex.quote(str(ROOT / "campaigns" / "machines" / "scenarios.sh"))

CAMPAIGNS = {
    "devices": Campaign(
        "random commands, kills, cuts, bad files on devices with habits of their own; each voltage judged", "2 h", 100
    ),
    "faults": Campaign("faults of nine buses on the whole daemon, each noticed in time and undone", "15 min"),
    "watched": Campaign("minutes recorded in full under browsers, metrics and OPC UA; nothing is lost", "11 min", 10),
    "robustness": Campaign("drawn plants commissioned; true margins beside those claimed", "25 min", 100),
    "foreign": Campaign("the same for plants of a class that the design does not know", "25 min", 40),
    "accuracy": Campaign("path error and sines of drawn plants and the real loop, beside the bound", "15 min", 50),
    "counterfactual": Campaign("tunings predicted on a recording, beside their simulation", "3 min", 20),
    "tune": Campaign("commission config/factory.yaml; write the tuned configurations", "3 min"),
    "mutation": Campaign("each mutant of the last gates and of the fault manager must die", "10 min"),
    "machine": Campaign(
        "ten thousand commands, faults, lines and swaps on the cell in virtual time",
        "10 min",
        command=_tests("--hypothesis-profile=soak tests/rt/test_cell_machine.py"),
    ),
    "recorder": Campaign(
        "a recorder killed at random moments; its file is read each time",
        "5 min",
        100,
        _tests("--kills {count} tests/host/test_mcap_recording.py"),
    ),
    "fuzz-socket": Campaign(
        "lines of garbage at the control socket",
        "10 min",
        1_000_000,
        _tests("tests/host/test_garbage.py --garbage {count}"),
    ),
    "fuzz-udp": Campaign(
        "datagrams of garbage at the driver udp",
        "20 min",
        10_000_000,
        _tests("tests/drivers/udp -k garbage --garbage {count}"),
    ),
    "fuzz-ethercat": Campaign(
        "garbled frames and mails at the master", "40 min", 1_000_000, _CHECKED + _tests(_FRAMES)
    ),
    "fuzz-workers": Campaign(
        "frames and packets of nobody at the compiled workers", "20 min", 1_000_000, _CHECKED + _tests(_WORKERS)
    ),
    "systemd": Campaign(
        "the service under a real systemd, on a throw-away copy of this machine; takes root",
        "5 min",
        command=f"{_MACHINE} namespace",
    ),
    "package": Campaign(
        "the Debian package from installing to a service that tracks, and back, with three cells; takes root",
        "50 min",
        command=_PACKAGE + " {only}",
    ),
    "vm": Campaign(
        "the service and SocketCAN on a PREEMPT_RT kernel, emulated; takes root, fetches 90 MB",
        "10 min",
        command=f"{_MACHINE} vm",
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
    given = parser.parse_args()
    if given.name is None:
        print("".join(f"{name:15} {each.takes:>7}  {each.does}\n" for name, each in CAMPAIGNS.items()), end="")
        return 0
    if given.name not in CAMPAIGNS:
        print(f"there is no campaign {given.name}; there are {', '.join(CAMPAIGNS)}", file=sys.stderr)
        return 64
    chosen = CAMPAIGNS[given.name]
    count = chosen.count if given.count is None else given.count
    if chosen.command:
        typed = shlex.split(chosen.command.format(count=count, only=given.only))
        return min(1, subprocess.run(typed, cwd=ROOT, check=False).returncode)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # with all that was started brought to its end
    with tempfile.TemporaryDirectory(prefix=f"{given.name}-") as folder:
        asked = Asked(Path(folder), given.seed, count, given.bus, given.only, given.jobs)
        report: Report = importlib.import_module(f"campaigns.{given.name}").run(asked)
    print(json.dumps(report.document(), indent=2, default=float) if given.json else report.text)
    if given.write:
        REPORTS.mkdir(exist_ok=True)
        (REPORTS / f"{given.name}.md").write_text(_page(given.name, chosen, report), encoding="utf-8")
    return 1 if report.wrong else 0


def _page(name: str, campaign: Campaign, report: Report) -> str:
    """The report with what it is of; its figures are of one run."""
    does = campaign.does[0].upper() + campaign.does[1:]
    head = f"# Report: {name}\n\n{does}. Written by `make campaign NAME={name} ARGS=--write`,"
    return f"{head} on {os.cpu_count()} CPUs.\n\n{report.text}"


if __name__ == "__main__":
    sys.exit(main())
