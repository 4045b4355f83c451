"""Random interleavings of commands, kills, stops, cuts, sets and bad files on one emulated device.

Each follows from the seed and its number: ``--only 17`` plays one again, ``--only 17 --shrink`` looks for fewer steps
that break the same rule.
"""

from .cells import CELLS
from .interleaving import by_rule, interleave
from .plan import plan
from .report import Report
from .watched_bench import WatchedBench

BUS, TRIES = "gcs", 3
"""What goes by real processes does not break each time: so often each set of steps is tried."""


def run(asked):
    """All of them on one bus, or on those that were asked for."""
    bench = WatchedBench(asked.folder, CELLS[asked.bus or BUS])
    numbers = range(asked.count) if not asked.only else (int(asked.only),)
    outcomes, report = [], Report()
    try:
        bench.start()
        assert bench.alive, f"no controller: {bench.notes}"
        if asked.shrink:
            return _shrunk(bench, asked, int(asked.only))
        for number in numbers:
            outcomes.append(interleave(bench, number, plan(asked.seed, number)))
            asked.tell(outcomes[-1].line)
    finally:
        left = bench.end()
    return judged(report, outcomes, left, f"{asked.bus or BUS}, seed {asked.seed}")


def judged(report, outcomes, left, title):
    """The report of interleavings, and of what was alive at the end."""
    report.tables = {title: by_rule(outcomes)}
    if broken := [each.row for each in outcomes if each.broken]:
        report.tables["Broken"] = broken
    values, seconds = sum(each.arrivals for each in outcomes), sum(each.seconds for each in outcomes)
    largest_V = max((each.largest_step_V for each in outcomes), default=0.0)
    report.notes.append(f"{len(outcomes)} interleavings: {values} values arrived in {seconds:.0f} s, "
                        f"the largest step between two was {largest_V:.3f} V")  # fmt: skip
    report.wrong += [f"number {each.number} broke {', '.join(sorted(each.broken))}" for each in outcomes if each.broken]
    report.wrong += [f"left behind: {each}" for each in left]
    return report


def _shrunk(bench, asked, number):
    """The fewest steps found that break a rule which interleaving `number` breaks."""
    steps = plan(asked.seed, number)
    rules, k = _broken(bench, number, steps), 0
    while rules and k < len(steps):
        fewer = steps[:k] + steps[k + 1 :]
        asked.tell("; ".join(map(str, fewer)))
        if found := _broken(bench, number, fewer) & rules if fewer else set():
            steps, rules = fewer, found
        else:
            k += 1
    rows = [{"step": k + 1, "what": str(step)} for k, step in enumerate(steps)]
    return Report({f"fewest steps of number {number}": rows}, [], [f"breaks {rule}" for rule in sorted(rules)])


def _broken(bench, number, steps):
    for _ in range(TRIES):
        if broken := interleave(bench, number, steps).broken:
            return broken
    return set()
