"""Judges what arrived at the device: by its values and their times, and never by what the product says of itself.

range     every value is finite and in the range of the last valid configuration
slew      no value differs from what the output has by more than a period of its task allows
unarmed   outputs that rest stay at rest until `arm` was accepted
claim     whenever the product says that the outputs rest, they do

On the bench there are five more:
charged   outputs that can be written rest soon after they were told to
astray    no loop tracks on while its outputs are in nobody's or the worker's hand
crash     no traceback, no bug
return    back to READY by documented means
left      nothing is left behind

What a device does by itself is nobody's fault, and where the next value begins.
"""

import math
import threading
import time
from bisect import bisect_right
from dataclasses import dataclass, field

SHOWN = "state"
"""Shown and not judged: OFF while the device is elsewhere, in a report that says so itself under `links`; and what is
said while a line that acknowledges nothing holds values back."""
REST_V = 0.5
"""So near to rest is at rest, where somebody claims it: what is on its way moves by more than that."""
REST_NS = 1_000_000_000
"""At rest for so long, and nothing but another `arm` may move it, whatever was accepted before."""
IN_FLIGHT_NS = 100_000_000
"""A claim may be ahead of what is on its way, by no more than this."""
BY_ITSELF_NS = 700_000_000
"""For so long after a device has left rest by itself, nobody can know."""
CHANGE_NS = 500_000_000
"""For so long after a change of range or slew limit the former ones are right too."""


@dataclass(eq=False)
class Arrival:
    """One output's value; `itself`: the device moved without being told."""

    time_ns: int
    name: str
    volts: float
    itself: bool = False


class Arrivals:
    """Those since the last `forget`; written by the device's thread."""

    def __init__(self):
        self._lock = threading.Lock()
        self._all = []
        self.count = 0

    def add(self, name, volts, *, itself=False):
        """One more, now."""
        self.take_up(Arrival(time.monotonic_ns(), name, volts, itself))

    def take_up(self, arrival):
        """One more, with its own time."""
        with self._lock:
            self._all.append(arrival)
            self.count += 1

    def copy(self):
        """In the order of arrival."""
        with self._lock:
            return list(self._all)

    def forget(self, before_ns):
        """Keep only what is newer, and the last of each output."""
        with self._lock:
            last = {each.name: each for each in self._all if each.time_ns < before_ns}
            old = sorted(last.values(), key=lambda each: each.time_ns)
            self._all = old + [each for each in self._all if each.time_ns >= before_ns]

    def volts(self):
        """Each output's newest value."""
        return {each.name: each.volts for each in self.copy()}


@dataclass(frozen=True)
class Bounds:
    """What one output may do; `step_V` is what its task may add in a period, `fine_V` what its line resolves."""

    low_V: float
    high_V: float
    step_V: float
    rest_V: float
    fine_V: float

    def at_rest(self, volts):
        return abs(volts - self.rest_V) <= self.fine_V


@dataclass(frozen=True)
class Violation:
    """One rule that was broken; `size` says how far, where that is a voltage."""

    rule: str
    what: str
    size_V: float = 0.0
    around: list = field(default_factory=list)
    """The arrivals before and after: (ms since the interleaving began, name, V)."""


@dataclass(frozen=True)
class Claim:
    """Between these times somebody said that the outputs rest."""

    from_ns: int
    to_ns: int
    who: str
    rule: str = "claim"


class Oracle:
    """Judges one interleaving after the other."""

    def __init__(self, arrivals, bounds):
        """`bounds` by output."""
        self._arrivals = arrivals
        self._bounds = [(0, dict(bounds))]
        self._armed_ns = []
        self._resting = False
        self._claims = []

    @property
    def bounds(self):
        """In force now, by output."""
        return self._bounds[-1][1]

    def change(self, bounds, now_ns):
        """Another valid configuration is in force."""
        self._bounds.append((now_ns, dict(bounds)))

    def armed(self, asked_ns):
        """An `arm` that was asked for at `asked_ns` was accepted, or may have been."""
        self._armed_ns.append(asked_ns)

    def claim(self, from_ns, to_ns, who, rule="claim"):
        """The product said so."""
        self._claims.append(Claim(from_ns, to_ns, who, rule))

    def at_rest(self):
        """Whether each output's newest value is the one at rest; so it is where nothing ever came."""
        volts = self._arrivals.volts()
        return all(bounds.at_rest(volts.get(name, bounds.rest_V)) for name, bounds in self.bounds.items())

    def settled(self):
        """The campaign has brought everything to rest: from now on nothing may move without `arm`."""
        self._resting = True

    def judge(self, begin_ns, end_ns):
        """What was wrong since `begin_ns`; forgets what lies before `end_ns`."""
        arrivals = self._arrivals.copy()
        found = [
            Violation(rule, what, size_V, around(arrivals, each, begin_ns))
            for rule, what, size_V, each in self._moves(arrivals, begin_ns)
        ]
        found += self._lies(arrivals)
        self._arrivals.forget(end_ns)
        self._bounds = self._bounds[-2:]
        self._armed_ns, self._claims = [at for at in self._armed_ns if at >= end_ns], []
        return found

    def largest_step_V(self):
        """Between two values in a row of those that are remembered."""
        last, largest = {}, 0.0
        for each in self._arrivals.copy():
            if not each.itself:
                largest = max(largest, abs(each.volts - last.get(each.name, each.volts)))
            last[each.name] = each.volts
        return largest

    def _moves(self, arrivals, begin_ns):
        last, rest_since_ns = {}, None
        for each in arrivals:
            fresh, volts = each.time_ns >= begin_ns, each.volts
            if fresh and not each.itself:
                allowed = [bounds[each.name] for bounds in self._in_force(each.time_ns)]
                low_V, high_V, step_V = allowed[-1].low_V, allowed[-1].high_V, max(b.step_V + b.fine_V for b in allowed)
                before_V = last.get(each.name, volts)
                if not any(b.low_V - b.fine_V <= volts <= b.high_V + b.fine_V for b in allowed):
                    what = f"{each.name} was given {volts:g} V, its range is {low_V:g} to {high_V:g} V"
                    yield "range", what, max(low_V - volts, volts - high_V), each
                if not abs(volts - before_V) <= step_V and math.isfinite(volts):
                    what = f"{each.name} went from {before_V:g} to {volts:g} V in one step, {step_V:.2f} V are allowed"
                    yield "slew", what, abs(volts - before_V), each
            last[each.name] = volts
            if not fresh:
                continue
            resting = all(bounds.at_rest(last.get(name, bounds.rest_V)) for name, bounds in self.bounds.items())
            armed = any(at <= each.time_ns for at in self._armed_ns)
            if self._resting and armed:
                self._resting, rest_since_ns = False, None
            if not resting:
                if self._resting and not each.itself:
                    yield "unarmed", f"{each.name} left rest for {volts:g} V, and nobody had armed", abs(volts), each
                self._resting, rest_since_ns = False, None
            else:
                rest_since_ns = each.time_ns if rest_since_ns is None else rest_since_ns
                if not self._resting and each.time_ns - rest_since_ns >= REST_NS:
                    self._resting = True
                    self._armed_ns = [at for at in self._armed_ns if at > each.time_ns]

    def _in_force(self, time_ns):
        """The bounds at a time, and those that were just before."""
        until = [*(at for at, _ in self._bounds[1:]), math.inf]
        return [
            bounds
            for (at, bounds), end in zip(self._bounds, until, strict=True)
            if at <= time_ns and time_ns < end + CHANGE_NS
        ]

    def _lies(self, arrivals):
        """Claims during which, and shortly before and after, the outputs rested at no time."""
        last, elsewhere = {}, []
        for each in arrivals:
            last[each.name] = each.volts
            known = [(name, last[name], bounds.rest_V) for name, bounds in self.bounds.items() if name in last]
            elsewhere.append({name: volts for name, volts, rest_V in known if not abs(volts - rest_V) <= REST_V})
        times_ns = [each.time_ns for each in arrivals]
        left_ns = [each.time_ns for each in arrivals if each.itself and abs(each.volts) > REST_V]
        for claim in self._claims:
            first = bisect_right(times_ns, claim.from_ns - IN_FLIGHT_NS)
            end = bisect_right(times_ns, claim.to_ns + IN_FLIGHT_NS)
            during = elsewhere[first - 1 : end] if first else [{}]
            if all(during) and not any(0 <= claim.to_ns - at_ns < BY_ITSELF_NS for at_ns in left_ns):
                moved = {name: f"{volts:g} V" for name, volts in during[-1].items()}
                worst_V = max(abs(volts - self.bounds[name].rest_V) for name, volts in during[-1].items())
                yield Violation(claim.rule, f"{claim.who}; the device was at {moved}", worst_V)


def around(arrivals, each, begin_ns):
    """What that output was given just before and after: (ms, V); its own moves are marked."""
    same = [arrival for arrival in arrivals if arrival.name == each.name]
    place = same.index(each)
    return [
        (round((arrival.time_ns - begin_ns) * 1e-6, 1), arrival.volts, *(["itself"] if arrival.itself else []))
        for arrival in same[max(0, place - 4) : place + 4]
    ]


def few(violations):
    """The worst of each rule, and for claims of each who made one."""
    kept = {}
    for each in sorted(violations, key=lambda violation: -violation.size_V):
        kept.setdefault((each.rule, each.what.split(";")[0] if each.rule in ("claim", SHOWN) else ""), each)
    return [*kept.values()]


@dataclass
class Interleaving:
    """What was done, and what was wrong."""

    number: int
    steps: list
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
