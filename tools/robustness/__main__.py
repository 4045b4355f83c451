"""``make robustness``: a line a plant; exit code 1 for a false PASS, or too few that pass."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from micromanip.design.parallel import each
from micromanip.settings.check import prepare

from .campaign import CONFIG, HELD, Outcome, commission_drawn

PLANTS, WANTED = 100, 0.85


def one(seed: int) -> Outcome:
    """By seed alone, for another process."""
    return commission_drawn(prepare(CONFIG), seed)


def main() -> int:
    """Draw, commission, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="First seed.")
    parser.add_argument("--plants", type=int, default=PLANTS, help="How many.")
    parser.add_argument("--jobs", type=int, default=1, help="Processes.")
    parser.add_argument("--json", type=Path, help="File for a line of JSON a plant.")
    given = parser.parse_args()
    write: Callable[[str], object] = sys.stdout.write
    results: list[Outcome] = []
    for outcome in each(one, range(given.first, given.first + given.plants), given.jobs):
        results.append(outcome)
        write(outcome.line + "\n")
        sys.stdout.flush()
        if given.json:
            with given.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(outcome)) + "\n")
    passed, false = sum(o.passed for o in results), [o.seed for o in results if o.false_pass]
    least = min((share for o in results if o.passed for share in o.kept.values()), default=float("nan"))
    write(
        f"{passed} of {len(results)} PASS, {len(results) - passed} with a reason; false PASS: {len(false)} {false}; "
        f"least share of a claimed margin among those that pass {least:.2f} (at least {HELD:g} wanted)\n"
    )
    return 0 if not false and passed >= WANTED * len(results) else 1


if __name__ == "__main__":
    sys.exit(main())
