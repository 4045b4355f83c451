"""Devices that move by themselves while no command comes, and can't be asked: judged at the device, not at our side.

A watchdog that does not latch, a power cycle: the first value after it must not step, whoever writes it.
"""

import contextlib
import math
import time

import pytest

from campaigns.oracle import Arrivals
from campaigns.played.amplifier import OUTPUTS as OUTPUTS_OF_TWO
from campaigns.played.amplifier import Amplifier as PlayedAmplifier
from campaigns.played.amplifier import Habits
from campaigns.virtual_worker import ANSWERED, Clock, Wire
from micromanip.bus import device_lock
from micromanip.bus.beginning import after_silence, begin, place
from micromanip.bus.driver import BusDriver, BusOptions, Channel, Task
from micromanip.bus.errors import LinkError, OutputsUnknown
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import SWITCH, VOLTAGE, Left, OutputWriter, SafeOutput, SafeState
from micromanip.bus.watchdog import Watchdog
from micromanip.bus.worker import Rules
from micromanip.host.safe.bus_rest import BusRest
from micromanip.rt.bus_image import RESTING
from micromanip.rt.io import gate
from micromanip.rt.jit import plain

from .running_worker import RunningWorker

note_sent, note_taken = plain(gate.note_sent), plain(gate.note_taken)
RATE_HZ, STEP_V = 500.0, 4.0
OUTPUTS = (SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, STEP_V * RATE_HZ),)
TASKS = (Task("all", RATE_HZ, (0,)),)
RULES = Rules(OUTPUTS, 0.1, 500_000_000, 0)
WATCHDOG = Watchdog(ms=300, rest_ms=50, after_power_on="rest")
KEEPS = Watchdog(ms=None, after_power_on="last")


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


class Served(RunningWorker):
    def __init__(self, line, memory=None, **known):
        super().__init__(line, RULES, memory, **known)

    def __exit__(self, *raised):
        self.worker._may_leave = lambda: True
        super().__exit__(*raised)

    def follow(self, volts):
        super().follow(volts, lambda: self.driver.amplifier.volts == volts)


@pytest.fixture(autouse=True)
def said(monkeypatch, tmp_path):
    told = []
    monkeypatch.setattr("micromanip.bus.report.send_message", lambda **document: told.append(document))
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
        served.until(lambda: line.opened == 2 and served.safe.state == RESTING, 60.0)
        served.follow(60.0)
    assert line.amplifier.largest <= STEP_V + 1e-9


def _given(volts, folder):
    memory = LastGiven.open("amplifier", ["voltage"], folder)
    memory.write([volts])
    return memory


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
        served.until(lambda: any(document["event"] == "latched" for document in said), 0.0)
    (told,) = [document["text"] for document in said if document["event"] == "latched"]
    assert "nobody knows what voltage of amplifier has: nothing is written" in told
    assert line.amplifier.writes == 0
    assert "`watchdog`" in BusRest(line, OUTPUTS, 0.1).rest()[0]
    assert line.amplifier.writes == 0
    assert BusRest(line, OUTPUTS, 0.1, at_rest=True).rest() == []
    assert line.amplifier.largest <= STEP_V


LATER = Watchdog(ms=300, rest_ms=50, after_power_on="last")
EVER = math.inf
BEGUN, STILL = (0, 270_000_001), (380_000_000, EVER)
ON_ITS_WAY = (379_999_999, EVER)
AT_60 = {"last": 60.0, "given": (59.0, 61.0), "register": (59.0, 61.0)}
NOTHING = {"given": None, "register": (EVER, -EVER)}


@pytest.mark.parametrize(
    ("keys", "silent_ns", "left", "reads", "expected"),
    [
        # what it reads it has, as long as no watchdog can have begun
        (WATCHDOG, (0, 270_000_000), AT_60, 33.0, (33.0, 33.0, 33.0)),
        (KEEPS, STILL, AT_60, 33.0, (33.0, 33.0, 33.0)),
        (WATCHDOG, BEGUN, AT_60, 33.0, None),
        (None, (0, 0), AT_60, 60.0, None),
        (None, (0, 0), {"given": (9.0, 10.0)}, None, (10.0, 9.0, 10.0)),
        # one that may be on its way to rest is waited for, unless that is within a step
        (WATCHDOG, ON_ITS_WAY, AT_60, None, None),
        (WATCHDOG, ON_ITS_WAY, AT_60, 0.0, None),
        (WATCHDOG, ON_ITS_WAY, NOTHING, 0.0, None),
        (WATCHDOG, ON_ITS_WAY, {"given": (-4.1, 4.0)}, None, None),
        (WATCHDOG, ON_ITS_WAY, {"given": (-4.0, 4.1)}, None, None),
        (WATCHDOG, ON_ITS_WAY, {"given": (-4.0, 4.0)}, -4.1, None),
        (WATCHDOG, ON_ITS_WAY, {"given": (-4.0, -3.0)}, None, (0.0, -4.0, 0.0)),
        (WATCHDOG, ON_ITS_WAY, {"given": (3.0, 4.0)}, None, (0.0, 0.0, 4.0)),
        (WATCHDOG, ON_ITS_WAY, {"given": (3.0, 4.0)}, -4.0, (0.0, -4.0, 0.0)),
        (LATER, ON_ITS_WAY, {"given": (10.0, 10.0)}, None, None),
        # then it is there, and a register may read what was written before
        (WATCHDOG, STILL, AT_60, None, (0.0, 0.0, 0.0)),
        (WATCHDOG, STILL, AT_60 | {"given": None}, None, (0.0, 0.0, 0.0)),
        (WATCHDOG, (EVER, EVER), AT_60, 65.0, (0.0, 0.0, 0.0)),
        (WATCHDOG, STILL, AT_60, 55.0, (0.0, 0.0, 0.0)),
        (WATCHDOG, STILL, AT_60, 65.1, None),
        (WATCHDOG, STILL, {"given": None, "register": (-61.0, -59.0)}, -60.0, (0.0, 0.0, 0.0)),
        (WATCHDOG, STILL, AT_60, 54.9, None),
        (WATCHDOG, STILL, AT_60, STEP_V + 1e-9, (0.0, 0.0, STEP_V + 1e-9)),
        (WATCHDOG, STILL, AT_60, -4.0, (0.0, -4.0, 0.0)),
        (WATCHDOG, STILL, NOTHING, 60.0, (60.0, 60.0, 60.0)),
        (WATCHDOG, STILL, {"given": (0.0, 0.0), "register": (0.0, 0.0)}, 60.0, None),
        # where nobody knows what it does in silence, or once it is switched on
        *[
            (keys, STILL, left, reads, expected)
            for keys in (LATER, None)
            for left, reads, expected in (
                (AT_60, None, None),
                (AT_60, 60.0, None),
                (NOTHING, None, None),
                (NOTHING, 60.0, None),
                (AT_60, 3.0, (0.0, 0.0, 3.0)),
                ({"given": (6.0, 13.0)}, None, (10.0, 6.0, 13.0)),
                ({"given": (5.9, 13.0)}, None, None),
                ({"given": (11.0, 14.0)}, None, (10.0, 10.0, 14.0)),
                ({"given": (10.0, 10.0), "register": (-EVER, EVER)}, 60.0, (10.0, 10.0, 10.0)),
            )
        ],
        (KEEPS, STILL, AT_60, None, (60.0, 59.0, 61.0)),
        (KEEPS, STILL, NOTHING, None, None),
        (Watchdog(ms=None, after_power_on="rest"), STILL, AT_60, None, None),
    ],
)
def test_where_a_voltage_is_after_silence(keys, silent_ns, left, reads, expected):
    """Its device leads it to 0 V, the cell to 10 V."""
    of = {"kind": VOLTAGE, "rest": 0.0, "safe": 10.0, "step": STEP_V, "last": 10.0, "register": (0.0, 0.0)} | left
    found = after_silence(keys, silent_ns, Left(**of), reads)
    assert (found and (found.value, *found.bounds)) == expected


def _left_at(volts):
    safe = SafeState(OUTPUTS, TASKS, 0.1, 500_000_000)
    safe.remember([volts])
    return safe


def test_a_register_is_not_believed_where_the_link_is_lost_before_anything_was_given():
    """It was waited for and rests; what was sent then may have been lost, and the register have 60 V yet."""
    safe = _left_at(60.0)
    assert place(safe, WATCHDOG, WATCHDOG.still_ns, [60.0]) == []
    safe.fields["value"][0] = 0.0
    note_sent(safe.fields, 0, 0, 10**9)
    assert place(safe, WATCHDOG, 10**9 + 10_000_000, [60.0]) == [0]
    assert place(safe, WATCHDOG, 10**9 + WATCHDOG.still_ns, [60.0]) == []
    assert safe.last == [0.0]


class Opened(Line):
    """A voltage that begins at what `reads` has next, and a switch; who listens to it waits, and longer than asked."""

    outputs = Channel("voltage", RATE_HZ), Channel("switch", RATE_HZ)
    tasks = (Task("write", RATE_HZ, (0, 1)),)

    def __init__(self, keys, *reads):
        super().__init__(None, keys)
        self.reads, self.slices_ns, self.lives, self.clock = [*reads], [], 0, Clock()
        self.safe = SafeState([*OUTPUTS, SafeOutput(SWITCH, 1.0, 0.0, 1.0)], self.tasks, 0.1, 500_000_000)
        self.safe.remember([60.0, 1.0])
        self.safe.leave()

    def receive(self, inbox, until_ns):
        inbox.confirm(0)
        assert len(inbox.take_confirmed()) == 1, "what came before is not kept"
        self.slices_ns.append(until_ns - self.clock.monotonic_ns())
        self.clock.go_to(until_ns + 7)

    def alive(self):
        self.lives += 1

    def begin(self, fed_ms_ago=None):
        """Its worker has begun, or the link was lost, 10 ms ago."""
        with self.clock.in_force():
            writer = OutputWriter(self, self.safe, lambda last: None)
            if fed_ms_ago is not None:
                self.safe.fields["fed_ns"][0] = self.clock.monotonic_ns() + round((10 - fed_ms_ago) * 1e6)
            self.clock.go_to(self.clock.monotonic_ns() + 10_000_000)
            return begin(self, self.safe, writer, self.alive, lambda: self.reads.pop(0))

    def has(self, i):
        g = self.safe.fields
        return g["start"][i], g["last"][i], g["lowest"][i], g["highest"][i]


def test_a_device_that_goes_to_rest_is_listened_to_meanwhile_and_asked_again():
    """For 380 ms from its last command on, at the latest."""
    device = Opened(WATCHDOG, [33.0, 1.0], [None, 0.0])
    assert device.begin() == [None, 0.0]
    assert sum(device.slices_ns) + 7 * (device.lives - 1) == 370_000_000
    assert (max(device.slices_ns), device.lives) == (20_000_000, 19)
    assert (device.has(0), device.has(1)) == ((0.0,) * 4, (0.0,) * 4)
    assert device.safe.fields["still"][0] == 1, "it may be given something, however long that was"


@pytest.mark.parametrize(
    ("keys", "reads", "last"),
    [(KEEPS, [33.0, 0.0], [33.0, 0.0]), (KEEPS, [None, None], [60.0, 1.0]), (WATCHDOG, [33.0, None], [33.0, 1.0])],
)
def test_a_device_of_which_it_is_known_what_it_has_is_not_waited_for(keys, reads, last):
    device = Opened(keys, reads)
    assert device.begin(fed_ms_ago=200) == reads
    assert (device.slices_ns, device.safe.last, device.safe.fields["still"][0]) == ([], last, 0)


@pytest.mark.parametrize(("keys", "waits"), [(None, False), (KEEPS, False), (LATER, True)])
def test_of_voltages_that_nobody_knows_the_names_are_told_and_none_begins(keys, waits):
    device = Opened(keys, *[[None, 33.0, None]] * 2)
    device.outputs = Channel("x", RATE_HZ), Channel("y", RATE_HZ), Channel("z", RATE_HZ)
    device.tasks = (Task("write", RATE_HZ, (0, 1, 2)),)
    device.safe = SafeState(OUTPUTS * 3, device.tasks, 0.1, 500_000_000)
    with pytest.raises(OutputsUnknown, match=r"what x, (y, )?z of amplifier has: nothing is written"):
        device.begin()
    assert (device.slices_ns != []) == waits
    assert device.has(1) == (0.0,) * 4


def test_park_on_a_host_that_is_slow_gives_up_no_output_that_comes_nearer_to_rest(tmp_path):
    clock = Clock()
    with clock.in_force():
        amplifier = PlayedAmplifier(Habits(), Arrivals())
        amplifier.command(dict.fromkeys(OUTPUTS_OF_TWO, 60.0))
        wire = SlowWire(clock, amplifier, ANSWERED, KEEPS, connected=False)
        with contextlib.closing(LastGiven.open(wire.device, OUTPUTS_OF_TWO, tmp_path)) as memory:
            memory.write([60.0, 60.0])
        assert BusRest(wire, [SafeOutput(VOLTAGE, 0.0, -20.0, 100.0, 500.0)] * 2, 0.3).rest() == []
    assert [*amplifier.volts().values()] == pytest.approx([0.0, 0.0], abs=1e-9)


class SlowWire(Wire):
    """Each call takes a quarter of a second."""

    def _pass(self, ns):
        super()._pass(max(ns, 250_000_000))
