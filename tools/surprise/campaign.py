"""One interleaving after the other on one device; each is judged, and leaves the yard as it found it."""

import time
from dataclasses import asdict, dataclass, field

from .acts import act
from .plan import Step, plan
from .referee import SHOWN, Violation
from .yard import Yard

_MOST = 3
"""So many violations of a rule are kept of one interleaving."""


@dataclass
class Interleaving:
    """What was done, and what was wrong."""

    number: int
    steps: list[Step]
    seconds: float = 0.0
    largest_step_V: float = 0.0
    arrivals: int = 0
    violations: list[Violation] = field(default_factory=list)
    course: list = field(default_factory=list)
    """(ms, what was done or said), where something was wrong."""

    @property
    def broken(self):
        """The rules that were broken."""
        return {violation.rule for violation in self.violations} - {SHOWN}

    def document(self):
        return {
            "number": self.number,
            "steps": [str(step) for step in self.steps],
            "seconds": round(self.seconds, 2),
            "largest_step_V": self.largest_step_V,
            "arrivals": self.arrivals,
            "broken": sorted(self.broken),
            "violations": [asdict(violation) for violation in self.violations],
            "course": self.course,
        }


def campaign(folder, cell, seed, numbers):
    """The interleavings of `numbers` under `seed`; the last item is what was left behind at the end, a list."""
    yard = Yard(folder, cell)
    left = []
    try:
        yard.start()
        assert yard.alive, f"no controller: {yard.notes}"
        for number in numbers:
            yield interleave(yard, number, plan(seed, number))
    finally:
        left += yard.end()
    yield left


def interleave(yard, number, steps):
    """Do the steps, bring everything back, judge."""
    yard.found, yard.notes = [], []
    done = Interleaving(number, steps)
    begin_ns, before = time.monotonic_ns(), yard.arrivals.count
    if yard.referee.at_rest():
        yard.referee.settled()
    for step in steps:
        act(yard, step)
        time.sleep(step.pause_ms * 1e-3)
    yard.note("back to READY")
    yard.bring_back()
    end_ns = time.monotonic_ns()
    done.largest_step_V = yard.referee.largest_step_V()
    found = [*yard.referee.judge(begin_ns, end_ns), *yard.found]
    done.violations = _few(found)
    done.seconds, done.arrivals = (end_ns - begin_ns) * 1e-9, yard.arrivals.count - before
    if done.broken:
        done.course = [[round((at_ns - begin_ns) * 1e-6), text] for at_ns, text in yard.notes]
    return done


def _few(violations):
    """The worst of each rule, and for claims of each who made one."""
    kept, counts = [], {}
    for each in sorted(violations, key=lambda violation: -violation.size_V):
        said = each.rule in ("claim", SHOWN)
        kind = each.rule + (each.what.split(";")[0] if said else "")
        counts[kind] = counts.get(kind, 0) + 1
        if counts[kind] <= (1 if said else _MOST):
            kept.append(each)
    return kept
