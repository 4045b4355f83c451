"""The outputs of a bus on their way to rest without a worker: each step, each failure, and what is said of it."""

import itertools
import math
from dataclasses import replace

import pytest

from micromanip.bus import device_lock, safe_state, worker
from micromanip.bus.driver import BusDriver, BusOptions, Channel, Outcome, Task
from micromanip.bus.errors import DeviceFault, IdentityMismatch, LinkError, TransientError
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import LAST_SWITCH, SWITCH, UNUSED, VOLTAGE, SafeOutput
from micromanip.bus.watchdog import Watchdog
from micromanip.host.safe import bus_rest
from micromanip.host.safe.bus_rest import BusRest

RATE_HZ = 500.0
STEP_V = 4.0
SLEW_V_PER_S = STEP_V * RATE_HZ
OUTPUTS = (
    SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, SLEW_V_PER_S),
    SafeOutput(VOLTAGE, 10.0, -20.0, 150.0, SLEW_V_PER_S),
    SafeOutput(SWITCH, 1.0, 0.0, 1.0),
    SafeOutput(LAST_SWITCH, 0.0, 0.0, 1.0),
    SafeOutput(UNUSED, 7.0),
)
NAMES = ("voltage_x", "voltage_y", "feed_hold", "amplifier_enable", "spare")
RAMP_S = 0.05


class Clock:
    """In place of the module time: it passes only while somebody waits, and a little with each look at it."""

    def __init__(self):
        self.now_ns = 1_000_000_000_000

    def monotonic_ns(self):
        self.now_ns += 1_000
        return self.now_ns

    def monotonic(self):
        return self.monotonic_ns() * 1e-9

    def sleep(self, seconds):
        assert seconds >= 0.0
        self.now_ns += round(seconds * 1e9)


time = Clock()


class Bus(BusDriver):
    """Three devices on one line: voltage x; voltage y; the switches and what nobody uses. SYNC writes nothing."""

    Options = BusOptions
    device, inputs, loads = "bench", (), ()
    silence = Watchdog(ms=None, after_power_on="last")
    outputs = tuple(Channel(name, RATE_HZ) for name in NAMES)
    tasks = (
        Task("SYNC", RATE_HZ, serves_outputs=True),
        Task("x", RATE_HZ, (0,)),
        Task("y", RATE_HZ, (1,)),
        Task("lines", RATE_HZ, (2, 3, 4)),
    )

    def __init__(self, **has):
        self.has = {"voltage_x": 0.0, "voltage_y": 0.0, "feed_hold": 0.0, "amplifier_enable": 1.0, "spare": 0.0} | has
        self.written = []
        """Number of a task, and what the device had after it."""
        self.asked = True
        self.raises = {}
        """What a task, "open" or "read" raises; a list: one after the other, None for nothing."""
        self.outcome = {}
        self.opened = self.closed = 0
        self.gone = True
        self.stuck = {}

    def _raise(self, what):
        found = self.raises.get(what)
        if isinstance(found, list):
            found = found.pop(0) if found else None
        if isinstance(found, LinkError):
            self.gone = True
        if found is not None:
            raise found
        if self.gone:
            raise LinkError("it is not open")

    def open(self):
        self.opened += 1
        self.gone = False
        self._raise("open")

    def close(self):
        self.closed += 1
        self.gone = True

    def read_outputs(self):
        self._raise("read")
        return [self.stuck.get(name, self.has[name]) for name in NAMES] if self.asked else [None] * len(NAMES)

    def perform(self, task, values, inbox):
        assert len(values) == len(NAMES)
        self._raise(task)
        outcome = self.outcome.get(task)
        if isinstance(outcome, list):
            outcome = outcome.pop(0) if outcome else None
        if outcome is not Outcome.HELD:
            self.has |= {NAMES[i]: values[i] for i in self.tasks[task].outputs}
            self.written.append((task, dict(self.has)))
        if outcome == "confirmed":
            inbox.confirm(task)
            return Outcome.SENT
        return outcome

    def receive(self, inbox, until_ns):
        self._raise("receive")
        time.sleep(max(0, until_ns - time.monotonic_ns()) * 1e-9)

    def course(self, name):
        """Values of an output, from the first on."""
        return [has[name] for _, has in self.written]


@pytest.fixture(autouse=True)
def _virtual_time(tmp_path, monkeypatch):
    monkeypatch.setattr(device_lock, "FOLDER", tmp_path)
    for module in (bus_rest, safe_state, worker):
        monkeypatch.setattr(module, "time", time)


def rested(bus, outputs=OUTPUTS, ramp_s=RAMP_S, **known):
    """What was said of it: failures and notes."""
    rest = BusRest(bus, outputs, ramp_s, **known)
    failed = rest.rest()
    assert bus.closed >= bus.opened
    return failed, rest.notes


def steps(course):
    return [abs(b - a) for a, b in itertools.pairwise(course)]


SAFE = {"voltage_x": 0.0, "voltage_y": 10.0, "feed_hold": 1.0, "amplifier_enable": 0.0, "spare": 7.0}


def test_from_what_the_device_reads_back_in_steps_of_the_slew_limit():
    bus = Bus(voltage_x=80.0, voltage_y=-20.0)
    assert rested(bus) == ([], [])
    assert bus.has == SAFE
    for name, start in (("voltage_x", 80.0), ("voltage_y", -20.0)):
        course = [start, *bus.course(name)]
        assert max(steps(course)) <= STEP_V * (1 + 1e-9)
        assert course == sorted(course, reverse=start > 0), "straight there"


def test_the_feed_is_held_at_once_and_the_amplifier_stays_on_until_the_voltages_are_at_rest():
    bus = Bus(voltage_x=80.0)
    assert rested(bus)[0] == []
    lines = [has for task, has in bus.written if task == 3]
    assert {has["feed_hold"] for has in lines} == {1.0}, "0 would tell the machine to feed"
    assert {has["spare"] for has in lines} == {7.0}
    cut = [has for has in lines if has["amplifier_enable"] == 0.0]
    assert all((has["voltage_x"], has["voltage_y"]) == (0.0, 10.0) for has in cut)
    assert len(cut) < len(lines), "it was on before"


def test_what_writes_nothing_is_done_too():
    bus = Bus(voltage_x=80.0)
    rested(bus)
    assert sum(task == 0 for task, _ in bus.written) > 10, "without SYNC no node takes its outputs over"


def test_what_it_was_given_last_counts_where_the_device_cannot_be_asked(tmp_path):
    memory = LastGiven.open("bench", NAMES, tmp_path)
    memory.write([80.0, 10.0, 1.0, 1.0, 0.0])
    memory.close()
    bus = Bus(voltage_x=80.0, voltage_y=10.0)
    bus.asked = False
    assert rested(bus) == ([], [])
    course = [80.0, *bus.course("voltage_x")]
    assert max(steps(course)) <= STEP_V * (1 + 1e-9)
    assert set(bus.course("voltage_y")) == {10.0}
    assert LastGiven.open("bench", NAMES, tmp_path).read() == [0.0, 10.0, 1.0, 0.0, 7.0]


def test_what_nobody_knows_is_not_written_before_a_person_has_said_that_it_rests():
    bus = Bus()
    bus.asked = False
    failed, _ = rested(bus)
    assert "nobody knows what voltage_x, voltage_y of bench has: nothing is written" in failed[0]
    assert "`watchdog`" in failed[0]
    assert bus.written == []
    assert rested(bus, at_rest=True) == ([], [])
    assert bus.has == SAFE


def test_what_is_known_of_some_is_used(tmp_path):
    memory = LastGiven.open("bench", NAMES, tmp_path)
    memory.write([80.0, math.nan, math.nan, math.nan, math.nan])
    memory.close()
    bus = Bus(voltage_x=80.0)
    bus.asked = False
    assert "nobody knows what voltage_y of bench has" in rested(bus)[0][0]
    bus.raises["open"] = [None, LinkError("reset")]
    bus.raises["receive"] = [LinkError("reset")]
    assert rested(bus, simulated=True) == ([], [])
    assert max(steps([80.0, *bus.course("voltage_x")])) <= STEP_V * (1 + 1e-9)


def test_the_memory_that_is_not_ours_is_said_and_keeps_nothing_from_rest(tmp_path):
    (tmp_path / "bench.given").mkdir()
    bus = Bus(voltage_x=80.0)
    failed, notes = rested(bus)
    assert failed == []
    assert len(notes) == 1
    assert "can't be remembered" in notes[0]
    assert bus.has == SAFE


@pytest.mark.parametrize(
    "error", [DeviceFault("unit 3: illegal address"), TransientError("no answer of unit 3"), LinkError("reset")]
)
@pytest.mark.parametrize("failing", [1, 2, 3])
def test_one_failing_task_leaves_the_others_tried(error, failing):
    bus = Bus(voltage_x=80.0, voltage_y=-20.0)
    bus.raises[failing] = error
    failed, _ = rested(bus)
    left = {1: ["voltage_x"], 2: ["voltage_y"], 3: ["feed_hold", "amplifier_enable"]}[failing]
    expected = SAFE | {name: bus.has[name] for name in left} | ({"spare": 0.0} if failing == 3 else {})
    if failing != 3:
        expected["amplifier_enable"] = 1.0
        left = [*left, "amplifier_enable"]
    assert bus.has == expected, "the amplifier is not cut off under a voltage"
    assert len(failed) == len(left)
    for line, name in zip(failed, sorted(left, key=NAMES.index), strict=True):
        assert line.startswith(f"{name} (safe: ")
        assert "can't be called safe" in line
    assert str(error) in failed[0]


def test_without_any_knowledge_that_is_told_too():
    bus = Bus()
    bus.asked = False
    bus.raises["open"] = LinkError("no route")
    failed, _ = rested(bus)
    assert failed[0] == "voltage_x (safe: 0 V) can't be called safe: nobody knows what it has; no route"
    assert len(failed) == 4, "what nobody uses is not told"
    assert bus.written == []
    assert bus.opened > 2


def test_a_link_that_comes_back_is_used():
    bus = Bus(voltage_x=80.0)
    bus.raises["open"] = [LinkError("busy"), None]
    bus.raises[1] = [None] * 3 + [LinkError("reset")]
    assert rested(bus)[0] == []
    assert bus.opened == 4, "the last time to be asked what it has"
    assert bus.has == SAFE
    assert max(steps([80.0, *bus.course("voltage_x")])) <= STEP_V * (1 + 1e-9)


def test_the_wrong_device_is_not_written_to():
    bus = Bus(voltage_x=80.0)
    bus.raises["open"] = IdentityMismatch("serial number 8")
    failed, _ = rested(bus)
    assert bus.opened == 1
    assert bus.written == []
    assert "serial number 8" in failed[0]


def test_what_was_held_back_or_not_answered_is_not_called_safe():
    for outcome in (Outcome.HELD, Outcome.SENT):
        bus = Bus(voltage_x=80.0)
        bus.outcome[1] = outcome
        failed, _ = rested(bus)
        assert failed[0] == "voltage_x (safe: 0 V) can't be called safe: unknown, last 80 V; it was not acknowledged"
        assert abs(bus.has["voltage_x"] - 80.0) <= STEP_V, "within a step of all that it may have"


def test_a_device_that_takes_everything_and_does_something_else():
    bus = Bus(voltage_x=80.0)
    rest = BusRest(bus, OUTPUTS, RAMP_S)
    perform = bus.perform

    def sticks(task, values, inbox):
        bus.stuck["voltage_x"] = 80.0
        return perform(task, values, inbox)

    bus.perform = sticks
    assert rest.rest() == ["voltage_x (safe: 0 V) was given and reads 80 V"]


def test_a_device_that_can_only_be_asked_when_it_is_opened_is_opened_anew():
    bus = Bus(voltage_x=80.0)
    read, at_opening = bus.read_outputs, {}

    def read_outputs():
        return at_opening.setdefault(bus.opened, read())

    bus.read_outputs = read_outputs
    assert rested(bus)[0] == []
    assert bus.opened == 2


def test_a_device_that_reads_back_nearly_the_value_or_later_is_right():
    bus = Bus(voltage_x=80.0)
    bus.stuck["voltage_y"] = 10.0 + 0.009 * 170.0
    perform = bus.perform

    def lags(task, values, inbox):
        outcome = perform(task, values, inbox)
        bus.stuck["feed_hold"] = 0.0  # switches are not compared: a device may read them as it likes
        return outcome

    bus.perform = lags
    assert rested(bus)[0] == []


def test_what_cannot_be_read_back_at_the_end_is_said():
    bus = Bus(voltage_x=80.0)
    bus.raises["read"] = [None, *[TransientError("no answer")] * 1000]
    assert rested(bus)[0] == ["its outputs were given their safe values, but can't be read back: no answer"]


def test_it_ends_whatever_the_device_does():
    """It takes every value, loses the link after it, and has 80 V again."""
    bus = Bus(voltage_x=80.0)
    bus.stuck["voltage_x"] = 80.0
    bus.raises["receive"] = LinkError("reset")
    begun_s = time.monotonic()
    failed, _ = rested(bus)
    assert "voltage_x" in failed[0]
    longest_s = RAMP_S + 170.0 / SLEW_V_PER_S + 10.0
    assert longest_s <= time.monotonic() - begun_s < longest_s + 0.5
    assert max(steps([80.0, *bus.course("voltage_x")])) <= STEP_V * (1 + 1e-9)


def test_it_has_the_time_that_ramp_and_slew_take(monkeypatch):
    monkeypatch.setattr(bus_rest, "_SPARE_S", 0.1)
    slow = [replace(output, slew_V_per_s=50.0) for output in OUTPUTS]
    for ramp_s in (RAMP_S, 5.0):
        bus = Bus(voltage_x=150.0)
        begun_s = time.monotonic()
        assert rested(bus, slow, ramp_s)[0] == []
        assert time.monotonic() - begun_s >= 0.99 * max(ramp_s, 150.0 / 50.0)
        assert bus.has == pytest.approx(SAFE)


def test_what_broke_the_link_is_tried_again_however_long_the_others_take():
    bus = Bus(voltage_x=80.0, voltage_y=80.0)
    bus.raises[1] = [LinkError("reset")]
    assert rested(bus, ramp_s=8.0)[0] == []
    assert bus.has == pytest.approx(SAFE)


def test_a_task_is_given_up_after_three_seconds_and_two_turns():
    for rate_hz in (RATE_HZ, 0.5):

        class Rated(Bus):
            tasks = tuple(replace(task, rate_hz=rate_hz) for task in Bus.tasks)

        bus = Rated(voltage_x=80.0)
        bus.outcome[1] = Outcome.HELD
        begun_s = time.monotonic()
        assert len(rested(bus)[0]) == 2
        took_s = time.monotonic() - begun_s
        assert 3.0 + 2 / rate_hz <= took_s < 3.1 + 4 / rate_hz + RAMP_S
