"""Faults of a bus, one after the other, on the whole daemon and a simulated device: `make fault-campaign`.

The table goes to standard output, with `--write` also to docs/fault-campaign.md. Exit code 1 where something was
not as it must be.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from hil.bench import Outcome
from hil.campaign import campaign
from hil.cases import CASES, Case

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "fault-campaign.md"
HEAD = """# Fault campaign

What faults of a bus do to the whole controller: daemon, worker and loop as in operation, the devices of
`config/can.yaml` played by `simulate-device`. One daemon goes through all of them. Written by
`make fault-campaign`; figures of one run on a shared machine with two processors.

A stepped wall clock, the overflow of a receive queue, and an interface that goes down need a kernel of their own:
`make test-vm` has them on SocketCAN. The loop and the host are killed in `make soak-kill`.

"""


def row(case: Case, outcome: Outcome) -> str:
    """A line of the table."""
    expected = " or ".join(case.codes) or "tracks on"
    detected = "-" if math.isnan(outcome.detected_ms) else f"{outcome.detected_ms:.0f} of {case.within_ms:.0f}"
    span = "-" if math.isnan(outcome.lowest_V) else f"{outcome.lowest_V:.1f} to {outcome.highest_V:.1f}"
    back = "-" if math.isnan(outcome.back_s) else f"{outcome.back_s:.1f}"
    verdict = "; ".join(outcome.wrong) or case.note or "as it must be"
    return f"| {case.name} | {expected} | {outcome.code or 'tracked on'} | {detected} | {span} | {back} | {verdict} |"


def main() -> int:
    """0 where everything was as it must be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="cases whose names this regular expression finds")
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.relative_to(ROOT)} too")
    parser.add_argument("--json", action="store_true", help="one document with every outcome instead of the table")
    options = parser.parse_args()
    cases = tuple(case for case in CASES if re.search(options.only, case.name))
    outcomes = []
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        for outcome in campaign(Path(folder), cases, f"faults-{os.getpid()}"):
            outcomes.append(outcome)
            good = "ok" if not outcome.wrong else f"WRONG: {'; '.join(outcome.wrong)}"
            print(f"{len(outcomes):>3} {outcome.name}: {outcome.code or '-'}: {good}", file=sys.stderr, flush=True)
    *each, end = outcomes
    lines = [
        "| fault, for 0.6 s | must follow | followed | after ms, of | outputs, V | tracks again after s | verdict |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        *(row(case, outcome) for case, outcome in zip(cases, each, strict=True)),
    ]
    table = "\n".join(lines) + f"\n\nLeft behind at the end: {'; '.join(end.wrong) or 'nothing'}.\n"
    print(json.dumps([outcome.as_dict() for outcome in outcomes], indent=2) if options.json else table)
    if options.write:
        PAGE.write_text(HEAD + table, encoding="utf-8")
    return int(any(outcome.wrong for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
