"""One interleaving: its steps are done on the watched bench, everything is brought back to READY, the oracle judges."""

import time
from dataclasses import dataclass, field

from .acts import act
from .oracle import RULES, SHOWN, Violation
from .plan import Step

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
    """(ms, what was done or said)."""

    @property
    def broken(self):
        """The rules that were broken."""
        return {violation.rule for violation in self.violations} - {SHOWN}

    @property
    def line(self):
        """Its steps, and how each violation came about."""
        lines = [f"{self.number:>5} {self.seconds:6.2f} s  {'; '.join(map(str, self.steps))}"]
        if self.broken:
            for violation in self.violations:
                lines.append(f"      {violation.rule.upper()}: {violation.what}")
                if violation.around:
                    lines.append(f"        given (ms, V): {violation.around}")
            lines += [f"        {at_ms:>6} ms {text}" for at_ms, text in self.course]
        return "\n".join(lines)

    @property
    def row(self):
        """For a table of those that broke a rule."""
        steps, what = "; ".join(map(str, self.steps)), "; ".join(each.what for each in self.violations)
        return {"number": self.number, "broken": ", ".join(sorted(self.broken)), "steps": steps, "what": what}


def interleave(bench, number, steps):
    """Do the steps, bring everything back, judge."""
    bench.found, bench.notes = [], []
    done = Interleaving(number, steps)
    begin_ns, before = time.monotonic_ns(), bench.arrivals.count
    if bench.oracle.at_rest():
        bench.oracle.settled()
    for step in steps:
        act(bench, step)
        time.sleep(step.pause_ms * 1e-3)
    bench.note("back to READY")
    bench.bring_back()
    end_ns = time.monotonic_ns()
    done.largest_step_V = bench.oracle.largest_step_V()
    done.violations = few([*bench.oracle.judge(begin_ns, end_ns), *bench.found])
    done.seconds, done.arrivals = (end_ns - begin_ns) * 1e-9, bench.arrivals.count - before
    done.course = [[round((at_ns - begin_ns) * 1e-6), text] for at_ns, text in bench.notes]
    return done


def few(violations):
    """The worst of each rule, and for claims of each who made one."""
    kept, counts = [], {}
    for each in sorted(violations, key=lambda violation: -violation.size_V):
        said = each.rule in ("claim", SHOWN)
        kind = each.rule + (each.what.split(";")[0] if said else "")
        counts[kind] = counts.get(kind, 0) + 1
        if counts[kind] <= (1 if said else _MOST):
            kept.append(each)
    return kept


def by_rule(outcomes):
    """Rows of a table: how often each rule was broken, how far, and where first."""
    rows = []
    for rule in (*RULES, SHOWN):
        met = [each for each in outcomes if any(v.rule == rule for v in each.violations)]
        worst_V = max((v.size_V for each in met for v in each.violations if v.rule == rule), default=0.0)
        rows.append({"rule": rule, "broken in": len(met), "worst, V": worst_V,
                     "first": " ".join(str(each.number) for each in met[:8])})  # fmt: skip
    return rows
