"""Faults of a bus, one after the other, on the whole daemon and a simulated device: `make fault-campaign`.

The tables go to standard output, with `--write` also to docs/fault-campaign.md, where those of examples that were not
tried stay as they are. Exit code 1 where something was not as it must be.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
import tempfile
from pathlib import Path

from .bench import Outcome
from .campaign import BUSES, TITLES, campaign
from .cases import Case

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "reports" / "fault-campaign.md"
HEAD = """# Fault campaign

What faults of a bus do to the whole controller: daemon, workers and loop as in operation, the devices of an example
played by `device simulate`. One daemon goes through all faults of an example. Written by
`make fault-campaign`; the figures of a table are of one run on a shared machine with two processors. What must follow
goes by what a fault does to the cell (no samples, commands that don't arrive, neither); whichever watch notices first
is right. What went wrong while loop or device came 5 ms late or more, as that machine sometimes does, was tried again,
at most twice.

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
    if outcome.before:
        verdict += f" (before, {' and '.join(f'{late:.0f}' for late in outcome.before)} ms late: not)"
    return f"| {case.name} | {expected} | {outcome.code or 'tracked on'} | {detected} | {span} | {back} | {verdict} |"


def title(name: str) -> str:
    """Of a table."""
    return TITLES.get(name, f"config/{name}.yaml")


def table(name: str, cases: tuple[Case, ...], outcomes: list[Outcome]) -> str:
    """The outcomes on one example; the last is that of its end."""
    *each, end = outcomes
    lines = [
        f"## {title(name)}",
        "",
        "| fault, for 0.6 s | must follow | followed | after ms, of | outputs, V | tracks again after s | verdict |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        *(row(case, outcome) for case, outcome in zip(cases, each, strict=True)),
        "",
        f"Left behind at the end: {'; '.join(end.wrong) or 'nothing'}{end.note and f' ({end.note})'}.",
    ]
    return "\n".join(lines) + "\n"


def page(tables: dict[str, str]) -> str:
    """The page with these tables, by example; the others are as they stand there."""
    stands = re.split(r"(?m)^(?=## )", PAGE.read_text(encoding="utf-8"))[1:] if PAGE.exists() else []
    kept = {text.splitlines()[0]: text.rstrip("\n") + "\n" for text in stands}
    new = {text.splitlines()[0]: text for text in tables.values()}
    order = [f"## {title(name)}" for name in BUSES]
    return HEAD + "\n".join((kept | new)[head] for head in order if head in kept | new)


def tried(name: str, cases: tuple[Case, ...]) -> list[Outcome]:
    """All cases on one example."""
    outcomes = []
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        for outcome in campaign(Path(folder), BUSES[name][0](), cases):
            outcomes.append(outcome)
            good = "ok" if not outcome.wrong else f"WRONG: {'; '.join(outcome.wrong)}"
            tried = f" (at the {len(outcome.before) + 1}. try)" if outcome.before else ""
            text = f"{name} {len(outcomes):>3} {outcome.name}: {outcome.code or '-'}: {good}{tried}"
            print(text, file=sys.stderr, flush=True)
    return outcomes


def main() -> int:
    """0 where everything was as it must be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bus", choices=BUSES, action="append", help="an example; all of them otherwise")
    parser.add_argument("--only", default="", help="cases whose names this regular expression finds")
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.relative_to(ROOT)} too")
    parser.add_argument("--json", action="store_true", help="one document with every outcome instead of the tables")
    options = parser.parse_args()
    if options.only and options.write:
        parser.error("--write takes whole tables: leave out --only")
    found: dict[str, list[Outcome]] = {}
    tables = {}
    for name in options.bus or BUSES:
        cases = tuple(case for case in BUSES[name][1] if re.search(options.only, case.name))
        found[name] = tried(name, cases)
        tables[name] = table(name, cases, found[name])
    text = "\n".join(tables.values())
    print(json.dumps({k: [o.as_dict() for o in v] for k, v in found.items()}, indent=2) if options.json else text)
    if options.write:
        PAGE.write_text(page(tables), encoding="utf-8")
    return int(any(outcome.wrong for outcomes in found.values() for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
