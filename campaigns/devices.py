"""Random interleavings of commands, kills, stops, cuts, sets and bad files on devices with habits of their own.

A device has its own watchdog or none, may latch, is switched off and on, can't always be read back, fails in its
readings, is deaf and silent once opened. What no host can prevent is not drawn: a value that its line held back until
after its watchdog began (``Habits.longest_under_way_s``), and a file that denies a watchdog.

Each interleaving follows from the seed and its number, the device's habits from those of its group: ``--bus rtu --only
17`` plays one again.
"""

import multiprocessing
import signal
import sys
from concurrent.futures import ProcessPoolExecutor

from .cells import CELLS
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
    groups = {}
    for bus in buses:
        for number in numbers[bus]:
            groups.setdefault((number // (10 * GROUP if bus == WORKER else GROUP), bus), []).append(number)
    outcomes, report = {bus: [] for bus in buses}, Report()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(asked.jobs, context, _ended_in_order, max_tasks_per_child=1) as pool:
        playing = {key: pool.submit(_played, asked, *key, groups[key]) for key in sorted(groups)}
        try:
            for (_, bus), each in playing.items():
                done, wrong = each.result()
                outcomes[bus] += done
                report.wrong += [f"{bus}: {one}" for one in wrong]
        finally:
            pool.shutdown(cancel_futures=True)  # who ends the campaign waits for what is played, not for all the others
    return judged(report, outcomes, f"seed {asked.seed}")


def _ended_in_order():
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


def _played(asked, group, bus, numbers):
    """The interleavings of one group, on one device; why there is none, and what was left at its end."""
    if bus == WORKER:
        return [interleaved(asked.seed, number, asked.folder) for number in numbers], []
    cell, outcomes, wrong = CELLS[bus], [], []
    bench = WatchedBench(asked.folder / f"{bus}-{group}", cell, *cell.habits(asked.seed, group))
    try:
        if (refused := bench.start_known()) is not None:
            wrong.append(f"group {group}: {refused}: {bench.notes}")
        for number in numbers if refused is None else ():
            outcomes.append(bench.interleave(asked.seed, number))
            asked.tell(f"{bus} {outcomes[-1].line}")
    finally:
        wrong += [f"left behind: {one}" for one in bench.end()]
    return outcomes, wrong


def judged(report, outcomes, title):
    """The report of interleavings by their buses."""
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
    if broken := [{"bus": bus} | each.row for bus, found in outcomes.items() for each in found if each.broken]:
        report.tables["Broken"] = broken
        report.wrong += [f"{row['bus']}: number {row['number']} broke {row['broken']}" for row in broken]
    return report
