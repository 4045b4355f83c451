"""Devices that move by themselves while no command comes, and can't be asked: judged at the device, not at our side.

A watchdog that does not latch, a power cycle: the first value after it must not step, whoever writes it.
"""

import contextlib
import threading
import time

import numpy as np
import pytest

from campaigns.arrivals import Arrivals
from campaigns.played.amplifier import OUTPUTS as OUTPUTS_OF_TWO
from campaigns.played.amplifier import Amplifier as PlayedAmplifier
from campaigns.played.amplifier import Habits
from campaigns.virtual_worker import ANSWERED, Clock, Wire
from micromanip.bus import device_lock
from micromanip.bus.driver import BusDriver, BusOptions, Channel, Task
from micromanip.bus.errors import LinkError
from micromanip.bus.image import ProcessImage
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import VOLTAGE, SafeOutput, SafeState
from micromanip.bus.watchdog import UNKNOWN, Watchdog, after_silence
from micromanip.bus.worker import Rules, Worker
from micromanip.host.safe.bus_rest import BusRest
from micromanip.rt.bus_exchange import exchange_image
from micromanip.rt.bus_image import FOLLOWING, IMAGE, RESTING
from micromanip.rt.io import gate
from micromanip.rt.jit import plain
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL

note_sent, note_taken = plain(gate.note_sent), plain(gate.note_taken)
RATE_HZ, STEP_V = 500.0, 4.0
OUTPUTS = (SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, STEP_V * RATE_HZ),)
TASKS = (Task("all", RATE_HZ, (0,)),)
RULES = Rules(OUTPUTS, 0.1, 500_000_000, 0)
WATCHDOG = Watchdog(ms=300, rest_ms=50, after_power_on="rest")
KEEPS = Watchdog(ms=None, after_power_on="last")
PATIENCE_S = 20.0


class Amplifier:
    """Rests at 0 V after `watchdog_s` without commands, at once and not latching; remembers its largest step."""

    def __init__(self, volts=0.0, watchdog_s=0.3):
        self.volts, self.watchdog_s, self.largest, self.fed_s, self.writes = volts, watchdog_s, 0.0, time.monotonic(), 0
        self.register = volts

    def command(self, volts):
        self.look()
        self.largest, self.volts = max(self.largest, abs(volts - self.volts)), volts
        self.register = volts
        self.fed_s, self.writes = time.monotonic(), self.writes + 1

    def look(self):
        if time.monotonic() - self.fed_s > self.watchdog_s:
            self.volts = 0.0


class Line(BusDriver):
    """A line without read-back to an amplifier, which `break_with` happens to in the next write."""

    Options = BusOptions
    device, inputs = "amplifier", ()
    outputs, tasks = (Channel("voltage", RATE_HZ),), (Task("write", RATE_HZ, (0,)),)

    def __init__(self, amplifier, silence=WATCHDOG):
        self.amplifier, self.keys, self.break_with, self.opened = amplifier, silence, None, 0

    @property
    def silence(self):
        return self.keys

    def loads(self):
        return ()

    def open(self):
        self.opened += 1

    def close(self):
        pass

    def perform(self, task, values, inbox):
        if self.break_with is not None:
            happens, self.break_with = self.break_with, None
            happens()
        self.amplifier.command(values[0])


class Served:
    """A worker in a thread that follows a loop in this one."""

    def __init__(self, line, memory=None, **known):
        self.line, self.record = line, np.zeros(1, IMAGE)
        self.record["outputs"] = 1
        self.record["silent_ns"] = self.record["patience_ns"] = 10**12
        self.signals, self.volts = np.zeros(MAX_SIGNALS, SIGNAL), np.zeros(MAX_OUTPUTS)
        self.worker = Worker(line, ProcessImage(self.record), RULES, memory, **known)
        self.thread = threading.Thread(target=self.worker.run, daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.worker.end()
        self.worker._may_leave = lambda: True
        self.thread.join(PATIENCE_S)

    def until(self, condition, volts=0.0):
        end_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end_s, "it did not come to pass"
            self.volts[0] = volts
            exchange_image(self.record[0], self.volts, self.signals, time.monotonic_ns())
            time.sleep(0.001)

    def follow(self, volts):
        self.until(lambda: self.worker.safe.state == FOLLOWING)
        self.until(lambda: self.line.amplifier.volts == volts, volts)


@pytest.fixture(autouse=True)
def said(monkeypatch, tmp_path):
    told = []
    monkeypatch.setattr("micromanip.bus.report.say", told.append)
    monkeypatch.setattr(device_lock, "FOLDER", tmp_path)
    return told


def _away(line, seconds=0.0, power=False):
    """What breaks the link: the amplifier is alone for a while, and perhaps switched off and on."""

    def happens():
        time.sleep(seconds)
        line.amplifier.look()
        if power:
            line.amplifier.volts = line.amplifier.register = 0.0
        raise LinkError("reset")

    return happens


@pytest.mark.live
@pytest.mark.parametrize("reads", [False, True])
@pytest.mark.parametrize(("seconds", "power"), [(0.0, True), (0.001, True), (0.4, False), (1.0, False)])
def test_a_link_that_comes_back_begins_where_the_device_is(seconds, power, reads):
    """Also where a register can be read, which keeps the set-point as long as the device has power."""
    line = Line(Amplifier())
    if reads:
        line.read_outputs = lambda: [line.amplifier.register]
    with Served(line, simulated=True) as served:
        served.follow(60.0)
        line.break_with = _away(line, seconds, power)
        served.until(lambda: line.opened == 2 and served.worker.safe.state == RESTING, 60.0)
        served.follow(60.0)
    assert line.amplifier.largest <= STEP_V + 1e-9


@pytest.mark.live
def test_a_worker_that_stood_still_with_its_link_up_counts_it_as_lost(said):
    line = Line(Amplifier())
    with Served(line, simulated=True) as served:
        served.follow(60.0)
        decide = served.worker._decide
        served.worker._decide = lambda now_ns: (
            time.sleep(0.6),
            decide(now_ns),
            setattr(served.worker, "_decide", decide),
        )
        served.until(lambda: line.opened == 2 and served.worker.safe.state == RESTING, 60.0)
    assert any("it may have gone to rest by itself" in document.get("text", "") for document in said)
    assert line.amplifier.largest <= STEP_V + 1e-9


def _given(volts, folder):
    memory = LastGiven.open("amplifier", ["voltage"], folder)
    memory.write([volts])
    return memory


@pytest.mark.live
@pytest.mark.parametrize("volts", [0.0, 60.0])
def test_a_new_worker_and_park_wait_until_the_device_rests(tmp_path, volts):
    """The amplifier has 60 V still, its watchdog's time begins now; or it lost them long ago (0 V)."""
    for park in (False, True):
        line, memory = Line(Amplifier(volts)), _given(60.0, tmp_path)
        if park:
            memory.close()
            assert BusRest(line, OUTPUTS, 0.1).run() == []
        else:
            with Served(line, memory) as served:
                served.until(lambda: served.worker.safe.state in (RESTING, FOLLOWING))
        assert line.amplifier.writes > 0
        assert line.amplifier.largest <= STEP_V + 1e-9


@pytest.mark.live
@pytest.mark.parametrize("reads", [False, True])
@pytest.mark.parametrize("keys", [None, Watchdog(ms=300, rest_ms=50, after_power_on="unknown")])
def test_where_nothing_is_known_a_person_is_asked_before_the_first_write(tmp_path, keys, reads, said):
    """Also where a register still reads what was written last: the output may have gone to rest by itself."""
    line = Line(Amplifier(), keys)
    if reads:
        line.amplifier.register = 60.0
        line.read_outputs = lambda: [line.amplifier.register]
    with Served(line, _given(60.0, tmp_path)) as served:
        served.until(lambda: any(document["event"] == "latched" for document in said))
    (told,) = [document["text"] for document in said if document["event"] == "latched"]
    assert "nobody knows what voltage of amplifier has: nothing is written" in told
    assert line.amplifier.writes == 0
    assert "`watchdog`" in BusRest(line, OUTPUTS, 0.1).run()[0]
    assert line.amplifier.writes == 0
    assert BusRest(line, OUTPUTS, 0.1, at_rest=True).run() == []
    assert line.amplifier.largest <= STEP_V


@pytest.mark.live
def test_what_was_left_at_rest_is_at_rest(tmp_path):
    line = Line(Amplifier(), None)
    with Served(line, _given(0.0, tmp_path)) as served:
        served.until(lambda: served.worker.safe.state == FOLLOWING)


@pytest.mark.parametrize(
    ("keys", "silent_ms", "expected"),
    [
        (WATCHDOG, 379, (0.0, 61.0)),
        (WATCHDOG, 380, (0.0, 0.0)),
        (KEEPS, 10**6, (59.0, 61.0)),
        (Watchdog(ms=None, after_power_on="rest"), 0, UNKNOWN),
        (Watchdog(ms=100, after_power_on="last"), 10**6, UNKNOWN),
        (None, 0, UNKNOWN),
    ],
)
def test_what_a_device_may_have_after_silence(keys, silent_ms, expected):
    assert after_silence(keys, silent_ms * 1_000_000, (59.0, 61.0), 0.0) == expected


@pytest.mark.live
def test_a_device_that_reads_back_other_than_rest_after_its_silence_is_led_on_from_there(tmp_path):
    line = Line(Amplifier(60.0, watchdog_s=1e9))
    line.read_outputs = lambda: [line.amplifier.volts]
    assert BusRest(line, OUTPUTS, 0.1).run() == []
    assert line.amplifier.volts == 0.0
    assert line.amplifier.largest <= STEP_V + 1e-9


@pytest.mark.parametrize("after_power_on", ["last", "unknown"])
def test_a_register_tells_nothing_where_the_watchdog_may_have_led_the_output_away_from_it(after_power_on):
    safe = _left_at(60.0)
    keys = Watchdog(ms=300, rest_ms=50, after_power_on=after_power_on)
    assert safe.after_silence(keys, keys.still_ns, [60.0]) == [0]
    assert _left_at(60.0).after_silence(keys, keys.still_ns, [1.0]) == []


@pytest.mark.parametrize("keys", [None, WATCHDOG, Watchdog(ms=300, rest_ms=50, after_power_on="unknown")])
def test_a_register_that_somebody_else_has_written_makes_what_was_left_at_rest_unknown(keys):
    """Or what was written last never came: then a device that its watchdog has led to rest is at rest."""
    assert _left_at(0.0).after_silence(keys, 10**9, [60.0]) == [0]
    vouched_for = _left_at(0.0)
    vouched_for.assume_safe()
    assert vouched_for.after_silence(keys, 10**9, [60.0]) == []
    assert vouched_for.last == [0.0]


def test_a_register_still_tells_the_set_point_where_the_link_is_lost_before_anything_was_given():
    safe = _left_at(60.0)
    assert safe.after_silence(WATCHDOG, WATCHDOG.still_ns, [60.0]) == []
    safe.fields["value"][0] = 0.0
    note_sent(safe.fields, 0, 0, 0)
    assert safe.after_silence(WATCHDOG, 10_000_000, [60.0]) == []
    assert safe.last == [0.0]


def test_a_register_a_step_from_rest_is_a_set_point_too():
    safe = _left_at(2.0 * STEP_V)
    assert safe.after_silence(WATCHDOG, WATCHDOG.still_ns, [STEP_V]) == []
    assert safe.last == [0.0]


@pytest.mark.parametrize("found", [0.0, -STEP_V])
def test_what_reads_nearer_to_rest_than_it_was_given_is_not_led_back(found):
    """Power was off and on while values were sent that nobody confirmed: they are bounds, and no way to go on."""
    safe = _left_at(-60.0)
    for value in (-40.0, 0.0):
        safe.fields["value"][0] = value
        note_sent(safe.fields, 0, 0, 0)
    safe.leave()
    assert safe.after_silence(KEEPS, 10**9, [found]) == []
    safe.decide([], 0, 10**9)
    assert found <= safe.values[0] <= 0.0


def _left_at(volts):
    safe = SafeState(OUTPUTS, TASKS, 0.1, 500_000_000)
    safe.remember([volts])
    return safe


@pytest.mark.parametrize("keys", [WATCHDOG, None])
def test_what_may_be_at_rest_by_itself_is_not_given_again_what_was_a_step_away(keys):
    safe = SafeState(OUTPUTS, TASKS, 0.1, 500_000_000)
    safe.read_back([6.0])
    safe.fields["value"][0] = STEP_V
    note_sent(safe.fields, 0, 0, 0)
    assert note_taken(safe.fields, 0, 0)
    assert safe.after_silence(keys, 0, [None]) == []
    safe.decide([0.0], 0, 10**9)
    assert safe.values == [0.0]


def test_park_on_a_host_that_is_slow_gives_up_no_output_that_comes_nearer_to_rest(tmp_path):
    clock = Clock()
    with clock.in_force():
        amplifier = PlayedAmplifier(Habits(), Arrivals())
        amplifier.command(dict.fromkeys(OUTPUTS_OF_TWO, 60.0))
        wire = SlowWire(clock, amplifier, ANSWERED, KEEPS, connected=False)
        with contextlib.closing(LastGiven.open(wire.device, OUTPUTS_OF_TWO, tmp_path)) as memory:
            memory.write([60.0, 60.0])
        assert BusRest(wire, [SafeOutput(VOLTAGE, 0.0, -20.0, 100.0, 500.0)] * 2, 0.3).run() == []
    assert [*amplifier.volts().values()] == pytest.approx([0.0, 0.0], abs=1e-9)


class SlowWire(Wire):
    """Each call takes a quarter of a second."""

    def _pass(self, ns):
        super()._pass(max(ns, 250_000_000))
