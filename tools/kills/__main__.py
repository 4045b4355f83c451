"""``kill -9`` of host, loop, recorder and black box in turn, at random moments: `make soak-kill`.

Every cycle's outputs are watched from outside. After each kill: what is documented happened, nothing was left behind,
and the next controller, on the same socket and device, comes to READY and is not armed. Exit code 1 otherwise.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from pathlib import Path
from statistics import median

from .campaign import VICTIMS, campaign
from .kills import Kill


def table(kills: list[Kill]) -> str:
    """A line a victim, then how often each moment was met."""
    lines = [f"{'killed':<10} {'times':>5}  {'largest step V':>14}  {'s until':>14}  {'left':>4}  outcome"]
    for victim in VICTIMS:
        met = [kill for kill in kills if kill.victim == victim]
        if not met:
            continue
        steps = max(kill.step_V for kill in met)
        seconds = [kill.seconds for kill in met if kill.seconds is not None]
        until = f"{median(seconds):.2f} to {max(seconds):.2f}" if seconds else "-"
        outcomes = ", ".join(f"{n}x {what}" for what, n in Counter(kill.outcome for kill in met).most_common())
        left = sum(len(kill.left) for kill in met)
        lines.append(f"{victim:<10} {len(met):>5}  {steps:>14.3f}  {until:>14}  {left:>4}  {outcomes}")
    frozen = [1e3 * kill.frozen_s for kill in kills if kill.frozen_s is not None]
    if frozen:
        lines.append(f"outputs of a dead loop stood still for {median(frozen):.0f} to {max(frozen):.0f} ms")
    states = Counter(kill.state + (f" ({kill.phase})" if kill.state == "ARMING" else "") for kill in kills)
    for title, counts in (("moment", Counter(kill.moment for kill in kills)), ("state at the kill", states)):
        lines.append(f"{title}: " + ", ".join(f"{n}x {name}" for name, n in counts.most_common()))
    return "\n".join(lines)


def main() -> int:
    """0 where everything was as documented."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100, help="so many kills (100)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments (1)")
    parser.add_argument("--json", action="store_true", help="one document with every kill instead of the table")
    options = parser.parse_args()
    kills = []
    with tempfile.TemporaryDirectory(prefix="kill-") as folder:
        for kill in campaign(options.count, options.seed, Path(folder)):
            kills.append(kill)
            good = "ok" if not (kill.violations or kill.left) else f"WRONG: {kill.violations} left: {kill.left}"
            course = " -> ".join(kill.course)
            print(f"{len(kills):>4} {kill.victim}, {kill.moment}: {course}: {good}", file=sys.stderr, flush=True)
    wrong = sum(bool(kill.violations or kill.left) for kill in kills)
    if options.json:
        document = {"seed": options.seed, "wrong": wrong, "kills": [kill.document() for kill in kills]}
        print(json.dumps(document, indent=2))
    else:
        print(table(kills))
        print(f"{len(kills)} kills, seed {options.seed}: {wrong} not as documented")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
