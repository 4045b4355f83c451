"""``kill -9`` of host, loop, worker, recorder and black box in turn, at random moments of a controller's life.

The oracle judges each voltage at the device, as ever. Besides: who dies ends the run or does not, as documented; people
are told; a death that ends the run leaves a whole black box; and the next controller comes to READY.
"""

import signal
from random import Random

from .cells import CELLS
from .devices import judged
from .interleaving import interleave
from .oracle import Violation
from .plan import Step
from .report import Report
from .running_controller import until
from .watched_bench import WatchedBench

VICTIMS = ("recorder", "host", "worker", "black box", "loop")
"""In turn; what lives on is followed by what ends the run, so that each is killed in one that has lived a while."""
ENDS = {"host": (-signal.SIGKILL, "X-101"), "loop": (1, "X-104")}
"""Exit code of the host, and the code of the black box."""
SAID = {
    "recorder": "the recorder of ",
    "black box": "the black box process died",
    "worker": "was killed by signal 9; started again",
}
TIGHT = {f"faults.axis.following_error.{key}": value for key, value in (("limit_um", 1e-6), ("time_ms", 0.1))}
"""A watch that trips at once."""
_BOX_S = 20.0


def moment(draw):
    """The name of a moment, and the steps that lead there from READY."""
    name = draw.choice(("arming", "tracking", "set", "holding", "ramping", "trip"))
    late_ms = draw.randrange(300)
    armed = Step("arm", 500)
    return name, {
        "arming": [Step("arm", late_ms)],
        "tracking": [Step("arm", 500 + late_ms)],
        "set": [armed, *(Step("set", draw.randrange(5), {"changes": {"axes.x.inner.K_V_per_um": 0.05 + 0.001 * k}})
                         for k in range(5))],
        "holding": [armed, Step("hold", late_ms)],
        "ramping": [armed, Step("disarm", late_ms)],
        "trip": [armed, Step("set", 2 * late_ms, {"changes": TIGHT})],
    }[name]  # fmt: skip


def run(asked):
    """`count` kills on one bus."""
    draw = Random(asked.seed)
    bus = asked.bus or "gcs"
    bench = WatchedBench(asked.folder, CELLS[bus])
    outcomes, rows = [], {}
    try:
        bench.start_known()
        for number in range(asked.count):
            victim = VICTIMS[number % len(VICTIMS)]
            name, steps = moment(draw)
            done = killed(bench, number, victim, steps)
            outcomes.append(done)
            row = rows.setdefault(victim, {"killed": victim, "times": 0, "wrong": 0, "largest step, V": 0.0})
            row["times"], row["wrong"] = row["times"] + 1, row["wrong"] + bool(done.broken)
            row["largest step, V"] = max(row["largest step, V"], done.largest_step_V)
            asked.tell(f"{name}: {done.line}")
    finally:
        left = bench.end()
    report = judged(Report(), {bus: outcomes}, f"seed {asked.seed}")
    report.wrong += [f"left behind: {each}" for each in left]
    report.tables = {"Who was killed": list(rows.values()), **report.tables}
    return report


def killed(bench, number, victim, steps):
    """One kill, everything brought back; what was not as documented is a violation of the rule `death`."""
    bench.fresh_boxes()
    done = interleave(bench, number, [*steps, Step("kill", 200, {"who": victim})])
    ended = [text for _, text in done.course if text.startswith("the controller ended with ")]
    if victim in ENDS:
        code, trip = ENDS[victim]
        if f"the controller ended with {code}" not in ended:
            _wrong(done, f"the {victim} was killed, and {ended or 'the controller lived on'}")
        if not _box(bench, trip):
            _wrong(done, f"the {victim} was killed, and no whole black box of {trip} is there")
        return done
    if ended:
        _wrong(done, f"the {victim} was killed, and {ended}")
    elif SAID[victim] not in bench.running.said:
        _wrong(done, f"the {victim} was killed, and nobody was told: {bench.running.said[-400:]}")
    return done


def _box(bench, code):
    """Whether a complete box of that code comes, every cycle in it once."""
    found = []

    def there():
        found.extend(bench.fresh_boxes())
        return any(box.trip["code"] == code for box in found)

    try:
        until(there, code, _BOX_S)
    except AssertionError:
        return False
    return all((box.rows["cycle"][1:] - box.rows["cycle"][:-1] == box.rows["periods"][1:]).all() for box in found)


def _wrong(done, what):
    done.violations.append(Violation("death", what))
