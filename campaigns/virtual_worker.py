"""The worker of a bus in virtual time, on a driver whose device has habits of its own; hundreds a minute.

A loop that asks for the extremes, workers that are killed, `park` where there is none: the same oracle judges.
"""

import contextlib
import heapq
import itertools
import sys
import time
from random import Random

import numpy as np

from micromanip.bus import device_lock, report
from micromanip.bus.driver import BusDriver, BusOptions, Channel, Outcome, Task
from micromanip.bus.errors import DeviceFault, LinkError, TransientError
from micromanip.bus.image import ProcessImage
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import VOLTAGE, SafeOutput
from micromanip.bus.watchdog import Watchdog
from micromanip.bus.worker import Rules, Worker
from micromanip.host.safe.bus_rest import BusRest
from micromanip.rt.bus_exchange import exchange_image
from micromanip.rt.bus_image import DOWN, FOLLOWING, IMAGE, LINK, LINK_LATCHED, LINK_UP, OUTPUT_STATE, RESTING, TAKEN
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL

from .oracle import Arrivals, Bounds, Interleaving, Oracle, Violation, few
from .played.amplifier import OUTPUTS, READS, Amplifier, Habits, HeldBack
from .steps import Step

RATE_HZ, SLEW_V_PER_S, RAMP_S = 100.0, 500.0, 0.3
_STEP_V, _LOOP_NS, _CALL_NS, _REPLY_NS = SLEW_V_PER_S / RATE_HZ, 4_000_000, 500_000, 50_000_000
_SILENCE_NS, _REST_S, _RANGE_V = 200_000_000, 12.0, (-20.0, 100.0)
_RULES = Rules([SafeOutput(VOLTAGE, 0.0, *_RANGE_V, SLEW_V_PER_S)] * 2, RAMP_S, 50_000_000, 100_000_000)
ANSWERED, CONFIRMED, BLIND = "each write is answered", "a later answer confirms", "nothing tells of a write"


BEGIN_NS = 10**12


class _KilledError(BaseException):
    """The worker's process is killed in the midst of whatever it does."""


class Clock:
    """In place of the module `time`; what is due happens while somebody waits."""

    def __init__(self):
        self._now_ns, self._due, self._number = BEGIN_NS, [], itertools.count()
        self.process_time = time.process_time

    def monotonic_ns(self):
        return self._now_ns

    def monotonic(self):
        return self._now_ns * 1e-9

    def sleep(self, seconds):
        self.go_to(self._now_ns + max(1000, round(seconds * 1e9)))

    def at(self, time_ns, call):
        heapq.heappush(self._due, (max(time_ns, self._now_ns), next(self._number), call))

    def go_to(self, time_ns):
        while self._due and self._due[0][0] <= time_ns:
            due_ns, _, call = heapq.heappop(self._due)
            self._now_ns = max(self._now_ns, due_ns)
            call()
        self._now_ns = max(self._now_ns, time_ns)

    @contextlib.contextmanager
    def in_force(self):
        """For the worker and all that it uses, and the device."""
        rooms = ("micromanip.bus.", "micromanip.host.safe.", "campaigns.oracle", "campaigns.played.amplifier")
        found = [m for name, m in sys.modules.items() if name.startswith(rooms) and getattr(m, "time", None) is time]
        for module in found:
            module.time = self
        try:
            yield
        finally:
            for module in found:
                module.time = time


class Wire(BusDriver):
    """Asks and writes; the device is called at once, or not at all."""

    Options, device, silence = BusOptions, "amplifier", None
    inputs = tuple(Channel(name, RATE_HZ) for name in "xy")
    outputs = tuple(Channel(name, RATE_HZ) for name in OUTPUTS)
    tasks = (Task("read", RATE_HZ), Task("x", RATE_HZ, (0,)), Task("y", RATE_HZ, (1,)))

    def __init__(self, clock, amplifier, way, silence, *, connected):
        """`connected`: a link that breaks when the device is switched on again."""
        self._clock, self._amplifier, self._way = clock, amplifier, way
        self.silence, self._connected = silence, connected
        self.cut, self._held, self._asked = None, HeldBack(amplifier), set()

    def loads(self):
        return ()

    def mend(self):
        """What was held back arrives, unless for too long."""
        self.cut = None
        for volts in self._held.arriving():
            self._amplifier.command(volts)

    def open(self):
        self._pass(_CALL_NS)
        if self._connected and (not self._amplifier.on or self.cut):
            self._pass(_REPLY_NS)
            raise LinkError("refused")
        self._boots = self._amplifier.boots
        self._asked.clear()
        self._pass(self._amplifier.habits.opening_ms * 1e6)
        self._deaf_ns, self._heard_ns = self._clock.monotonic_ns(), None

    def close(self):
        pass

    def read_outputs(self):
        registers = self._amplifier.registers()
        if registers is None or self._amplifier.fails in (*READS[:-1],) or not self._is_heard():
            self._pass(_REPLY_NS)
            return [None, None]
        self._pass(_CALL_NS)
        return [registers[name] for name in OUTPUTS]

    def perform(self, task, values, inbox):
        self._look()
        self._heard_ns = self._heard_ns or self._clock.monotonic_ns()
        if task == 0:
            return self._read(inbox)
        volts = {OUTPUTS[i]: values[i] for i in self.tasks[task].outputs}
        self._pass(_CALL_NS)
        if self.cut == "late":
            self._held.add(volts, self._clock.monotonic_ns())
        reaches = self.cut in (None, "deaf") and not (self._connected and self._boots != self._amplifier.boots)
        taken = reaches and self._amplifier.command(volts)
        if self._way != BLIND:
            if not self._is_heard():
                self._pass(_REPLY_NS)
                raise TransientError("no answer")
            if not taken:
                raise DeviceFault("refused")
            self._heard_ns = self._clock.monotonic_ns()
        if self._way == ANSWERED:
            return None
        self._asked.add(task)
        return Outcome.SENT

    def receive(self, inbox, until_ns):
        self._look()
        if self._is_heard():
            for task in self._asked:
                inbox.confirm(task)
            self._asked.clear()
        self._clock.go_to(max(until_ns, self._clock.monotonic_ns() + 1000))

    def _read(self, inbox):
        fails = self._amplifier.fails
        self._pass(_REPLY_NS if fails in ("silent", "late") or not self._is_heard() else _CALL_NS)
        if fails == "exception":
            raise DeviceFault("exception 4") if self._way == ANSWERED else TransientError("exception 6")
        if not self._is_heard() or fails in ("empty", "silent", "garbage", "late", "wrong unit"):
            raise TransientError(f"{fails or 'no'} answer")
        self._heard_ns = self._clock.monotonic_ns()
        values = [float("nan")] * 2 if fails == "nan" else self._amplifier.strains_um()
        inbox.put_all(0, values, self._heard_ns)

    def _look(self):
        now_ns = self._clock.monotonic_ns()
        if self._connected and self._boots != self._amplifier.boots:
            raise LinkError("connection reset")
        if self._heard_ns is not None and now_ns - self._heard_ns > _SILENCE_NS:
            raise LinkError("nothing understood for 200 ms")

    def _is_heard(self):
        return self.cut is None and self._amplifier.hears and self._clock.monotonic_ns() >= self._deaf_ns

    def _pass(self, ns):
        self._clock.go_to(self._clock.monotonic_ns() + round(ns))
        self._amplifier.look()


def habits(draw):
    """Of a device, how its writes are known to have arrived, and what is known of it: all drawn."""
    guarded, connected = draw.random() < 0.6, draw.random() < 0.5
    found = Habits(
        watchdog_ms=draw.choice((150.0, 300.0, 1000.0)) if guarded else None,
        rest_ms=draw.choice((0.0, 50.0, 250.0)) if guarded else 0.0,
        latches=guarded and draw.random() < 0.3,
        after_power_on=draw.choice(("rest", "rest", "last", "unknown")),
        reads_back=draw.random() < 0.4,
        opening_ms=draw.choice((0.0, 0.0, 300.0, 1500.0)),
        boot_ms=draw.choice((0.0, 50.0, 500.0)) if connected else 400.0,
    )
    silence = Watchdog(
        ms=found.watchdog_ms, rest_ms=found.rest_ms, latches=found.latches, after_power_on=found.after_power_on
    )
    return found, draw.choice((ANSWERED, CONFIRMED, BLIND)), silence if draw.random() < 0.9 else None, connected


def steps(draw):
    """What happens, and when."""
    found = [Step("arm", draw.choice((100, 500, 1000)))]
    for _ in range(draw.randint(2, 6)):
        kind = draw.choice(("arm", "disarm", "reads fail", "power", "power", "cut", "refuse", "stall", "kill", "park"))
        more = {
            "reads fail": {"how": draw.choice(READS), "ms": draw.choice((30, 150, 600, 5000))},
            "power": {"ms": draw.choice((1, 20, 100, 400, 1500, 20000))},
            "cut": {"how": draw.choice(("hole", "late", "deaf")), "ms": draw.choice((20, 80, 300, 900))},
            "refuse": {"ms": draw.choice((30, 300))},
            "stall": {"who": draw.choice(("loop", "worker")), "ms": draw.choice((30, 100, 600))},
        }.get(kind, {})
        found.append(Step(kind, draw.choice((0, 5, 50, 150, 400, 1500)), more))
    return found


class VirtualBench:
    """Device, loop, and the worker of the moment."""

    def __init__(self, seed, number):
        draw = Random(f"{seed}/{number}")
        self.clock, self.arrivals, self.notes = Clock(), Arrivals(), []
        self.habits, self.way, self.silence, self.connected = habits(draw)
        self.steps, self.found = steps(draw), []
        self._new_run()
        self._signals, self._outputs = np.zeros(MAX_SIGNALS, SIGNAL), np.zeros(MAX_OUTPUTS)
        self._draw, self._armed, self._ends, self._parks = draw, False, False, False
        self._stalled_ns, self._extreme = 0, [0.0, 0.0]
        self.worker = None

    def note(self, document):
        """What the worker tells."""
        if document["event"] != "statistics":
            at_ms = round((self.clock.monotonic_ns() - BEGIN_NS) * 1e-6)
            self.notes.append([at_ms, f"{document['event']}: {document.get('text', '')[:160]}"])

    def _new_run(self):
        self._image = np.zeros(1, IMAGE)
        self._image["inputs"] = self._image["outputs"] = 2
        self._image["silent_ns"], self._image["patience_ns"] = 100_000_000, 10**10

    def play(self):
        """All of it; what was wrong."""
        self.amplifier = Amplifier(self.habits, self.arrivals)
        self.wire = Wire(self.clock, self.amplifier, self.way, self.silence, connected=self.connected)
        self.oracle = Oracle(self.arrivals, dict.fromkeys(OUTPUTS, Bounds(*_RANGE_V, _STEP_V, 0.0, 1e-6)))
        self.oracle.settled()
        begin_ns = at_ns = self.clock.monotonic_ns()
        for step in self.steps:
            at_ns += step.pause_ms * 1_000_000
            self.clock.at(at_ns, lambda step=step: self._do(step))
        at_ns += max(step.more.get("ms", 0) for step in self.steps if step.kind != "reads fail") * 1_000_000
        self.clock.at(at_ns, self._disarm_for_good)
        self.clock.at(at_ns + round(_REST_S * 1e9), self._end)
        self._tick()
        while not self._ends:
            with contextlib.suppress(_KilledError):
                self._serve()
        self.largest_V = self.oracle.largest_step_V()
        return [*self.oracle.judge(begin_ns, self.clock.monotonic_ns()), *self.found]

    def _serve(self):
        """A worker's life, after `park` where that was asked for."""
        if self._parks:
            self._parks = False
            self._new_run()
            failed = BusRest(self.wire, _RULES.outputs, RAMP_S).rest()
            if not failed:
                now_ns = self.clock.monotonic_ns()
                self.oracle.claim(now_ns, now_ns, "park ended with 0")
        names = [channel.name for channel in self.wire.outputs]
        with contextlib.closing(LastGiven.open(self.wire.device, names)) as memory:
            self.worker = Worker(self.wire, ProcessImage(self._image), _RULES, memory)
            try:
                self.worker.run()
            finally:
                self.worker = None

    def _tick(self):
        """The loop's turn."""
        now_ns = self.clock.monotonic_ns()
        self.clock.at(now_ns + _LOOP_NS, self._tick)
        if now_ns < self._stalled_ns or self._parks:
            return
        if self._draw.random() < 0.05:
            self._extreme = [self._draw.choice((*_RANGE_V, 60.0)) for _ in OUTPUTS]
        self._outputs[:2] = self._extreme if self._armed else 0.0
        if exchange_image.dispatcher(self._image[0], self._outputs, self._signals, now_ns) in (DOWN, TAKEN):
            self._armed = False
        words = self._image["words"][0]
        if words[LINK] == LINK_UP and words[OUTPUT_STATE] == RESTING:
            self.oracle.claim(now_ns, now_ns, "status says outputs at rest")

    def _disarm_for_good(self):
        self._armed = False
        self.amplifier.fails = self._draw.choice((None, *READS))

    def _end(self):
        given_up = self._image["words"][0][LINK] == LINK_LATCHED or self.amplifier.latched
        if not (given_up or self.oracle.at_rest()):
            what = f"disarmed for {_REST_S:g} s, readings are {self.amplifier.fails}: {self.amplifier.volts()}"
            self.found.append(Violation("charged", what))
        self._ends = True
        raise _KilledError

    def _do(self, step):
        more, over_ns = step.more, self.clock.monotonic_ns() + step.more.get("ms", 0) * 1_000_000
        self.notes.append([round((self.clock.monotonic_ns() - BEGIN_NS) * 1e-6), str(step)])
        match step.kind:
            case "arm":
                if self._image["words"][0][OUTPUT_STATE] == FOLLOWING:
                    self._armed = True
                    self.oracle.armed(self.clock.monotonic_ns())
            case "disarm":
                self._armed = False
            case "reads fail":
                self.amplifier.fails = more["how"]
                self.clock.at(over_ns, lambda: setattr(self.amplifier, "fails", None))
            case "refuse" if self.way != BLIND:  # it would be the only one that knows
                self.amplifier.refuses = True
                self.clock.at(over_ns, lambda: setattr(self.amplifier, "refuses", False))
            case "power":
                self.amplifier.switch(False)
                self.clock.at(over_ns, lambda: self.amplifier.switch(True))
            case "cut":
                self.wire.cut = more["how"]
                self.clock.at(over_ns, self.wire.mend)
            case "stall" if more["who"] == "loop":
                self._stalled_ns = over_ns
            case "stall":
                self.clock.go_to(over_ns)
            case "kill" | "park":
                self._armed = False
                self._parks = step.kind == "park"
                raise _KilledError


def interleaved(seed, number, folder):
    """One of them; what devices were given last is kept in `folder` meanwhile, and nobody is told anything."""
    kept, said = device_lock.FOLDER, report.send_message
    device_lock.FOLDER = folder / f"{seed}-{number}"
    device_lock.FOLDER.mkdir()
    bench = VirtualBench(seed, number)
    report.send_message = lambda **document: bench.note(document)
    try:
        with bench.clock.in_force():
            begin_ns = bench.clock.monotonic_ns()
            found = few(bench.play())
    finally:
        device_lock.FOLDER, report.send_message = kept, said
    seconds = (bench.clock.monotonic_ns() - begin_ns) * 1e-9
    course = [[0, f"{bench.habits}, {bench.way}, {bench.silence}, connected: {bench.connected}"], *bench.notes]
    return Interleaving(number, bench.steps, seconds, bench.largest_V, bench.arrivals.count, found, course)
