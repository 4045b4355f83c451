"""Random interleavings of commands, kills, stops, cuts, sets and bad files on devices with habits of their own.

A device has its own watchdog or none, may latch, is switched off and on, can't always be read back, fails in its
readings, is deaf and silent once opened. What no host can prevent is not drawn: a value that its line held back until
after its watchdog began (``Habits.longest_under_way_s``).

Each interleaving follows from the seed and its number, the device's habits from those of its group: ``--bus rtu --only
17`` plays one again.
"""

import multiprocessing
import signal
import sys
from concurrent.futures import ProcessPoolExecutor

from .cells import CELLS
from .interleaving import by_rule, interleave
from .plan import plan
from .report import Report
from .virtual_worker import interleaved
from .watched_bench import WatchedBench

GROUP, WORKER = 6, "worker"
"""So many interleavings are played on one device. The worker alone is played in virtual time."""


def run(asked):
    """`count` of them on each bus, or on the one that was asked for; ten times as many of the worker alone."""
    buses = [asked.bus] if asked.bus else [*CELLS, WORKER]
    chosen = [int(asked.only)] if asked.only else None
    numbers = {bus: chosen or range(asked.count * (10 if bus == WORKER else 1)) for bus in buses}
    groups = sorted({(number // _size(bus), bus) for bus in buses for number in numbers[bus]})
    outcomes, report = {bus: [] for bus in buses}, Report()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(asked.jobs, context, _ended_in_order, max_tasks_per_child=1) as pool:
        playing = [pool.submit(_played, asked, bus, group, numbers[bus]) for group, bus in groups]
        for (_, bus), each in zip(groups, playing, strict=True):
            done, left = each.result()
            outcomes[bus] += done
            report.wrong += [f"{bus}: left behind: {one}" for one in left]
    return judged(report, outcomes, f"seed {asked.seed}")


def _size(bus):
    return 10 * GROUP if bus == WORKER else GROUP


def _ended_in_order():
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


def _played(asked, bus, group, numbers):
    """The interleavings of one group, on one device; what was left at its end."""
    if bus == WORKER:
        return [
            interleaved(asked.seed, number, asked.folder) for number in numbers if number // _size(bus) == group
        ], []
    bench, outcomes = _bench(asked, bus, group), []
    try:
        bench.start_known()
        for number in numbers:
            if number // GROUP == group:
                outcomes.append(interleave(bench, number, plan(asked.seed, number)))
                asked.tell(f"{bus} {outcomes[-1].line}")
    finally:
        left = bench.end()
    return outcomes, left


def _bench(asked, bus, group):
    cell = CELLS[bus]
    return WatchedBench(asked.folder / f"{bus}-{group}", cell, *cell.habits(asked.seed, group))


def judged(report, outcomes, title):
    """The report of interleavings by their buses."""
    every = [each for found in outcomes.values() for each in found]
    report.tables[title] = [
        {
            "bus": bus,
            "interleavings": len(found),
            "broke a rule": sum(bool(each.broken) for each in found),
            "values taken": sum(each.arrivals for each in found),
            "largest step, V": max((each.largest_step_V for each in found), default=0.0),
            "minutes": sum(each.seconds for each in found) / 60.0,
        }
        for bus, found in outcomes.items()
    ]
    report.tables["Rules"] = by_rule(every)
    if broken := [{"bus": bus} | each.row for bus, found in outcomes.items() for each in found if each.broken]:
        report.tables["Broken"] = broken
        report.wrong += [f"{row['bus']}: number {row['number']} broke {row['broken']}" for row in broken]
    return report
