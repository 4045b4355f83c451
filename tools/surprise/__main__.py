"""Random interleavings of commands, kills, stops, cuts, sets and bad files on one emulated device: `make surprise`.

A referee beside the device sees each value that arrives. After each interleaving everything is brought back to READY.
Exit code 1 where a rule was broken. Each interleaving follows from the seed and its number: `--seed 1 --only 17` plays
one again, `--shrink 17` looks for fewer steps that break the same rule. With `--log FILE` every outcome is kept, and
another call with the same file goes on where the former one ended.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from .campaign import campaign
from .cells import CELLS
from .referee import RULES, SHOWN
from .shrink import shrink


def table(outcomes: list[dict[str, Any]]) -> str:
    """A line a rule, then who claimed what was not so."""
    lines = [f"{'rule':<8} {'broken in':>9}  {'worst, V':>8}  interleavings"]
    for rule in (*RULES, SHOWN):
        met = [each for each in outcomes if any(v["rule"] == rule for v in each["violations"])]
        worst_V = max((v["size_V"] for each in met for v in each["violations"] if v["rule"] == rule), default=0.0)
        numbers = " ".join(str(each["number"]) for each in met[:12]) + (" ..." if len(met) > 12 else "")
        lines.append(f"{rule:<8} {len(met):>9}  {worst_V:>8.2f}  {numbers}")
    claims = Counter(
        v["what"].partition(";")[0] for each in outcomes for v in each["violations"] if v["rule"] in ("claim", SHOWN)
    )
    lines += [f"  {count}x {what}" for what, count in claims.most_common()]
    steps = Counter(step.split(",")[0].split(" (")[0] for each in outcomes for step in each["steps"])
    lines.append("steps: " + ", ".join(f"{count}x {kind}" for kind, count in steps.most_common()))
    seconds = sum(each["seconds"] for each in outcomes)
    values = sum(each["arrivals"] for each in outcomes)
    largest_V = max((each["largest_step_V"] for each in outcomes), default=0.0)
    lines.append(f"{values} values arrived in {seconds:.0f} s; the largest step between two was {largest_V:.3f} V")
    return "\n".join(lines)


def told(outcome: dict[str, Any]) -> str:
    """One interleaving in a line; with what was wrong and how it came about, where something was."""
    head = f"{outcome['number']:>5} {outcome['seconds']:6.2f} s  {'; '.join(outcome['steps'])}"
    if not outcome["broken"]:
        return head
    lines = [head]
    for violation in outcome["violations"]:
        lines.append(f"      {violation['rule'].upper()}: {violation['what']}")
        if violation["around"]:
            lines.append(f"        given (ms, V): {violation['around']}")
    lines += [f"        {at_ms:>6} ms {text}" for at_ms, text in outcome["course"]]
    return "\n".join(lines)


def main() -> int:
    """0 where no rule was broken."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cell", choices=[*CELLS], default="gcs", help="the bus between controller and device (gcs)")
    parser.add_argument("--count", type=int, default=1000, help="so many interleavings (1000)")
    parser.add_argument("--seed", type=int, default=1, help="what they follow from (1)")
    parser.add_argument("--first", type=int, default=0, metavar="K", help="begin with number K (0)")
    parser.add_argument("--only", type=int, metavar="K", help="only number K")
    parser.add_argument("--shrink", type=int, metavar="K", help="fewer steps of number K that break the same rule")
    parser.add_argument("--times", type=int, default=1, help="each so many times (1)")
    parser.add_argument("--minutes", type=float, help="begin no other one after so long")
    parser.add_argument("--log", type=Path, help="keep each outcome here, a line of JSON, and go on where it ends")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # with everything that was started brought to its end
    with tempfile.TemporaryDirectory(prefix="surprise-") as folder:
        if options.shrink is not None:
            steps, rules = shrink(Path(folder), CELLS[options.cell], options.seed, options.shrink)
            print("\n".join(map(str, steps)), f"\nbreaks {', '.join(rules) or 'nothing'}")
            return 1 if rules else 0
        return _campaign(Path(folder), options)


def _campaign(folder: Path, options: argparse.Namespace) -> int:
    outcomes = _logged(options.log)
    done = {each["number"] for each in outcomes}
    chosen = range(options.first, options.count) if options.only is None else (options.only,)
    numbers = [number for number in chosen if number not in done for _ in range(options.times)]
    left: list[str] = []
    for outcome in campaign(folder, CELLS[options.cell], options.seed, _until(numbers, options.minutes)):
        if isinstance(outcome, list):
            left = outcome
            continue
        document = outcome.document()
        outcomes.append(document)
        if options.log is not None:
            with options.log.open("a", encoding="utf-8") as log:
                log.write(json.dumps(document) + "\n")
        print(told(document), file=sys.stderr, flush=True)
    print(table(outcomes))
    wrong = sum(bool(each["broken"]) for each in outcomes)
    print(f"{len(outcomes)} interleavings on {options.cell}, seed {options.seed}: {wrong} broke a rule")
    if left:
        print(f"left behind: {left}")
    return 1 if wrong or left else 0


def _logged(log: Path | None) -> list[dict[str, Any]]:
    if log is None or not log.exists():
        return []
    return [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]


def _until(numbers: Iterable[int], minutes: float | None) -> Iterable[int]:
    end = None if minutes is None else time.monotonic() + 60.0 * minutes
    for number in numbers:
        if end is not None and time.monotonic() > end:
            return
        yield number


if __name__ == "__main__":
    sys.exit(main())
