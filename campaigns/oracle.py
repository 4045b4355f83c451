"""Judges what arrived at the device: by its values and their times, and never by what the product says of itself.

range     every value is finite and in the range of the last valid configuration
slew      no value differs from what the output has by more than a period of its task allows
unarmed   outputs that rest stay at rest until `arm` was accepted
claim     whenever the product says that the outputs rest, they do

What a device does by itself is nobody's fault, and where the next value begins.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass, field

RULES = ("range", "slew", "unarmed", "claim", "charged", "astray", "crash", "return", "left")
"""The last five are judged on the bench: outputs that do not rest though they were told to, and can be written; a loop
that tracks on while its outputs are in nobody's or the worker's hand; tracebacks and bugs; back to READY; nothing left
behind."""
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
        found = [*self._moves(arrivals, begin_ns), *self._lies(arrivals)]
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
        for k, each in enumerate(arrivals):
            fresh = each.time_ns >= begin_ns
            if fresh and not each.itself:
                allowed = self._in_force(each.time_ns)
                yield from self._of_range(each, [bounds[each.name] for bounds in allowed], arrivals, k, begin_ns)
                if each.name in last:
                    step_V = max(bounds[each.name].step_V + bounds[each.name].fine_V for bounds in allowed)
                    yield from _of_slew(each, last[each.name], step_V, arrivals, k, begin_ns)
            last[each.name] = each.volts
            if not fresh:
                continue
            resting = all(bounds.at_rest(last.get(name, bounds.rest_V)) for name, bounds in self.bounds.items())
            armed = any(at <= each.time_ns for at in self._armed_ns)
            if self._resting and armed:
                self._resting, rest_since_ns = False, None
            if not resting:
                if self._resting and not each.itself:
                    what = f"{each.name} left rest for {each.volts:g} V, and nobody had armed"
                    yield Violation("unarmed", what, abs(each.volts), around(arrivals, k, begin_ns))
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

    def _of_range(self, each, allowed, arrivals, k, begin_ns):
        if any(b.low_V - b.fine_V <= each.volts <= b.high_V + b.fine_V for b in allowed):
            return
        what = f"{each.name} was given {each.volts:g} V, its range is {allowed[-1].low_V:g} to {allowed[-1].high_V:g} V"
        beyond_V = max(allowed[-1].low_V - each.volts, each.volts - allowed[-1].high_V)
        yield Violation("range", what, beyond_V, around(arrivals, k, begin_ns))

    def _lies(self, arrivals):
        taken = [(each.time_ns, each.name, each.volts) for each in arrivals]
        left_ns = [each.time_ns for each in arrivals if each.itself and abs(each.volts) > REST_V]
        times_ns = [at_ns for at_ns, _, _ in taken]
        before, last = 0, {}
        for claim in sorted(self._claims, key=lambda each: each.from_ns):
            begin = bisect_right(times_ns, claim.from_ns - IN_FLIGHT_NS)
            last |= {name: volts for _, name, volts in taken[before:begin]}
            before = begin
            volts = self._best(dict(last), taken[begin : bisect_right(times_ns, claim.to_ns + IN_FLIGHT_NS)])
            if volts and not any(0 <= claim.to_ns - at_ns < BY_ITSELF_NS for at_ns in left_ns):
                moved = {name: f"{value:g} V" for name, value in volts.items()}
                worst_V = max(abs(value - self.bounds[name].rest_V) for name, value in volts.items())
                yield Violation(claim.rule, f"{claim.who}; the device was at {moved}", worst_V)

    def _best(self, last, taken):
        """Voltages that do not rest; none where all did at some time of the claim, or soon after."""
        found = self._elsewhere(last)
        for _, name, volts in taken:
            if not found:
                break
            last[name] = volts
            found = self._elsewhere(last)
        return found

    def _elsewhere(self, last):
        return {
            output: last[output]
            for output, bounds in self.bounds.items()
            if output in last and not abs(last[output] - bounds.rest_V) <= REST_V
        }


def _of_slew(each, before_V, step_V, arrivals, k, begin_ns):
    moved_V = abs(each.volts - before_V)
    if moved_V <= step_V or not math.isfinite(each.volts):
        return
    what = f"{each.name} went from {before_V:g} V to {each.volts:g} V in one step, {step_V:.2f} V are allowed"
    yield Violation("slew", what, moved_V, around(arrivals, k, begin_ns))


def around(arrivals, k, begin_ns):
    """What that output was given just before and after: (ms, V); its own moves are marked."""
    same = [(j, each) for j, each in enumerate(arrivals) if each.name == arrivals[k].name]
    place = next(i for i, (j, _) in enumerate(same) if j == k)
    return [
        (round((each.time_ns - begin_ns) * 1e-6, 1), each.volts, *(["itself"] if each.itself else []))
        for _, each in same[max(0, place - 4) : place + 4]
    ]
