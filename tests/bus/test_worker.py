"""The worker of a bus around a driver that does as it is told: what it gives the device, and how it comes back."""

import functools
import itertools
import threading
import time

import numpy as np
import pytest

from micromanip.bus.driver import BusDriver, BusOptions, Channel, Load, Outcome, Task
from micromanip.bus.errors import DeviceFault, IdentityMismatch, LinkError, OutputRefused, StillOpening, TransientError
from micromanip.bus.image import ProcessImage
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import SWITCH, VOLTAGE, SafeOutput
from micromanip.bus.watchdog import Watchdog
from micromanip.bus.worker import Rules, Worker
from micromanip.rt.bus_image import AT_REST, AWAY, IMAGE, RESTING, SAFE_RAMP, TAKEN

from .running_worker import PATIENCE_S, RunningWorker

pytestmark = pytest.mark.live  # ramps and pauses take their time

MS = 1_000_000
RAMP_S, DEAD_NS = 0.1, 300 * MS  # a loaded machine may hold a thread up for tens of ms
SLEW_V_PER_S = 5000.0
STEP_V = SLEW_V_PER_S / 500.0
OUTPUTS = (SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, SLEW_V_PER_S), SafeOutput(SWITCH, 1.0, 0.0, 1.0))
RULES = Rules(OUTPUTS, RAMP_S, DEAD_NS, 0)


class ScriptedDriver(BusDriver):
    """Notes what it is given; raises what a test puts into `errors`, one a call."""

    Options = BusOptions
    device = "scripted"
    silence = Watchdog(ms=None, after_power_on="last")
    inputs = (Channel("strain", 1000.0),)
    outputs = (Channel("voltage", 500.0), Channel("feed_hold", 500.0))
    tasks = (Task("write", 500.0, (0, 1)),)

    def __init__(self):
        self.errors, self.open_errors, self.given, self.opened, self.closed = [], [], [], 0, 0
        self.sequence, self.outcome, self.confirms = 0, None, False
        self.has = [None, None]
        self.before_each = lambda: None

    def loads(self):
        return (Load("scripted", 0.1, "nothing"),)

    def open(self):
        self.opened += 1
        if self.open_errors:
            raise self.open_errors.pop(0)

    def read_outputs(self):
        return self.has

    def perform(self, task, values, inbox):
        self.before_each()
        if self.errors:
            raise self.errors.pop(0)
        if self.outcome is not Outcome.HELD:
            self.given.append(tuple(values))
        return self.outcome

    def receive(self, inbox, until_ns):
        super().receive(inbox, until_ns)
        self.sequence += 1
        inbox.put(0, float(self.sequence), time.monotonic_ns())
        if self.confirms:
            inbox.confirm(0)

    def close(self):
        self.closed += 1


class Bench(RunningWorker):
    def __init__(self, driver=None, memory=None, record=None):
        super().__init__(driver or ScriptedDriver(), RULES, memory, record, simulated=True)

    def __exit__(self, *raised):
        super().__exit__(*raised)
        assert self.driver.closed == self.driver.opened

    def follow(self, voltage):
        super().follow(voltage, lambda: self.driver.given and self.driver.given[-1] == (voltage, 0.0))


@pytest.fixture
def said(monkeypatch):
    said = []
    monkeypatch.setattr("micromanip.bus.report.send_message", lambda **document: said.append(document))
    return said


@pytest.fixture
def bench(said):
    bench = Bench()
    bench.said = said
    with bench:
        yield bench


def events(bench):
    return [document["event"] for document in bench.said if document["event"] not in ("statistics", "outputs")]


def largest_step(driver, begins_at=0.0):
    voltages = [begins_at, *(given[0] for given in driver.given)]
    return max(abs(later - earlier) for earlier, later in itertools.pairwise(voltages))


def test_a_loop_that_dies_leaves_outputs_that_come_to_rest(bench):
    bench.follow(80.0)
    seen = len(bench.driver.given)
    bench.until(lambda: bench.safe.state == RESTING)  # nobody turns the loop any more
    bench.until(lambda: bench.driver.given[-1] == (0.0, 1.0))
    voltages = [given[0] for given in bench.driver.given[seen:]]
    assert all(later <= earlier for earlier, later in itertools.pairwise(voltages))
    assert any(0.0 < voltage < 80.0 for voltage in voltages)  # a ramp, not a step


@pytest.mark.parametrize("problem", [LinkError("unplugged"), DeviceFault("over-current")])
def test_after_a_lost_link_the_outputs_rest_until_the_loop_asks_for_it(bench, problem):
    bench.follow(80.0)
    bench.driver.errors.append(problem)
    bench.until(lambda: bench.driver.opened == 2, 80.0)
    bench.until(lambda: bench.image.link == "up", 80.0)
    bench.until(lambda: bench.safe.state == RESTING, 80.0)
    seen = len(bench.driver.given)
    bench.until(lambda: len(bench.driver.given) > seen + 20, 80.0)
    assert {given[0] for given in bench.driver.given[seen:]} == {0.0}
    assert events(bench) == ["up", "lost", "up"]
    bench.follow(80.0)


def test_errors_now_and_then_are_counted_many_are_a_lost_link(bench):
    bench.follow(10.0)
    bench.driver.errors += [TransientError("late"), OutputRefused("no")]
    bench.until(lambda: not bench.driver.errors, 10.0)
    assert bench.driver.opened == 1
    bench.driver.errors += [TransientError(f"late {k}") for k in range(20)]
    bench.until(lambda: bench.driver.opened == 2, 10.0)
    lost = next(document for document in bench.said if document["event"] == "lost")
    assert lost["text"].startswith("10 errors in the last 40 calls; the last: late")


class WokenByTasks:
    """Compiled turns that find the device silent only where the next task is due already."""

    begin = ask_back = lambda self: None

    def serve(self, safe, schedule, *_):
        time.sleep(max(0, schedule.next_ns() - time.monotonic_ns()) * 1e-9)
        return dict.fromkeys(("calls", "performed", "received", "lost"), 0), True


def test_a_task_that_is_always_due_does_not_keep_the_worker_from_hearing_that_the_device_is_silent(said, monkeypatch):
    """A device that was off and on for half a second was given the value of before in one step."""
    monkeypatch.setattr("micromanip.bus.worker.SteadyService.of", lambda *_: WokenByTasks())
    bench = Bench()

    def receive(inbox, until_ns):
        if bench.safe.state != SAFE_RAMP:
            raise LinkError("silent")
        ScriptedDriver.receive(bench.driver, inbox, until_ns)

    bench.driver.receive = receive
    with bench:
        bench.until(lambda: bench.driver.opened > 1, 0.0)
        bench.driver.receive = functools.partial(ScriptedDriver.receive, bench.driver)


def test_a_device_that_is_not_the_right_one_is_not_tried_again(bench, monkeypatch):
    monkeypatch.setattr("micromanip.bus.worker._UNREACHED_S", 0.2)  # nobody waits for it to come back
    bench.follow(10.0)
    bench.driver.open_errors = [IdentityMismatch("it says E-727, not E-709")]
    bench.driver.errors.append(LinkError("unplugged"))
    bench.until(lambda: bench.image.link == "latched", 10.0)
    opened = bench.driver.opened
    bench.until(lambda: len(bench.driver.given) > 0, 10.0)
    time.sleep(0.1)
    assert bench.driver.opened == opened
    assert bench.image.output_state == "unknown"
    assert events(bench) == ["up", "lost", "latched"]


def test_it_ends_only_when_the_outputs_are_at_rest(bench):
    bench.follow(80.0)
    bench.worker.end()
    time.sleep(0.01)
    assert bench.thread.is_alive()  # the loop still turns
    bench.thread.join(PATIENCE_S)
    assert not bench.thread.is_alive()
    assert bench.driver.given[-1] == (0.0, 1.0)


def test_the_loop_is_told_in_the_cycle_in_which_its_outputs_are_taken_away(bench):
    bench.follow(80.0)
    bench.until(lambda: bench.cycle(80.0) == AWAY, 80.0)
    bench.until(lambda: bench.safe.state == SAFE_RAMP)  # the loop stood still
    assert bench.cycle(80.0) == TAKEN
    bench.until(lambda: bench.safe.state == RESTING, 80.0)
    assert bench.cycle(80.0) == TAKEN
    bench.until(lambda: bench.cycle(0.0) == 0, 0.0)


def test_while_the_link_is_down_nobody_knows_and_afterwards_it_goes_on_from_the_last_value(bench):
    bench.follow(80.0)
    bench.driver.open_errors = [LinkError("unplugged")] * 4  # for longer than the ramp
    bench.driver.errors.append(LinkError("unplugged"))
    bench.until(lambda: bench.driver.opened == 5, 80.0)
    assert bench.image.output_state == "unknown"
    assert bench.image.known(2) == [80.0, 0.0]
    seen = len(bench.driver.given)
    bench.until(lambda: bench.image.output_state == "at rest", 80.0)
    assert abs(bench.driver.given[seen][0] - 80.0) < 1.0
    assert largest_step(bench.driver) <= STEP_V + 1e-9


def test_a_value_that_is_held_back_was_not_given(bench):
    bench.follow(80.0)
    bench.driver.outcome = Outcome.HELD
    bench.until(lambda: bench.safe.state == SAFE_RAMP)  # no loop any more
    time.sleep(3 * RAMP_S)
    assert bench.image.output_state == "ramping to rest"
    assert bench.image.known(2) == [80.0, 0.0]
    bench.driver.outcome = None
    bench.until(lambda: bench.image.output_state == "at rest")
    assert bench.image.known(2) == [0.0, 1.0]
    assert largest_step(bench.driver) <= STEP_V + 1e-9


def test_the_loop_finds_what_the_device_has_while_the_outputs_have_no_turn(bench):
    def finds(voltage):
        return bench.cycle(70.0) == AWAY and bench.outputs[0] == voltage

    bench.record["patience_ns"] = 50 * MS
    bench.follow(40.0)
    bench.driver.outcome = Outcome.HELD
    bench.until(lambda: finds(40.0))
    bench.driver.outcome = Outcome.SENT  # a turn, whether it is acknowledged or not
    bench.until(lambda: finds(70.0))
    bench.driver.confirms = True


def test_a_value_that_was_not_confirmed_was_not_given(bench):
    bench.follow(80.0)
    bench.driver.outcome = Outcome.SENT
    bench.until(lambda: bench.safe.state == SAFE_RAMP)
    time.sleep(3 * RAMP_S)
    assert bench.image.output_state == "ramping to rest"
    assert bench.image.known(2) == [80.0, 0.0]
    assert min(given[0] for given in bench.driver.given[-10:]) >= 80.0 - STEP_V
    bench.driver.confirms = True
    bench.until(lambda: bench.image.output_state == "at rest")
    assert bench.image.known(2) == [0.0, 1.0]
    assert largest_step(bench.driver) <= STEP_V + 1e-9


def test_a_voltage_out_of_range_is_told(said):
    bench = Bench()
    bench.driver.has = [200.0, 1.0]
    with bench:
        bench.until(lambda: bench.safe.state == RESTING)
        assert bench.driver.given[0][0] == pytest.approx(150.0, abs=0.1)
    told = [document["text"] for document in said if document["event"] == "outputs"]
    assert told == ["voltage reads 200, which is outside of its range"]


def test_new_rules_are_taken_while_it_runs(bench):
    bench.follow(80.0)
    slow = (SafeOutput(VOLTAGE, 0.0, -20.0, 100.0, SLEW_V_PER_S / 100), OUTPUTS[1])
    bench.worker.adopt(Rules(slow, RAMP_S, DEAD_NS, 0))
    bench.until(lambda: bench.safe.refused > 0, 101.0)
    seen = len(bench.driver.given)
    bench.until(lambda: len(bench.driver.given) > seen + 10, 90.0)
    voltages = [given[0] for given in bench.driver.given[seen:]]
    assert max(later - earlier for earlier, later in itertools.pairwise(voltages)) <= STEP_V / 100 + 1e-9


def test_at_the_end_every_task_is_tried_and_each_failure_is_told(said):
    class TwoTasks(ScriptedDriver):
        tasks = (Task("voltages", 500.0, (0,)), Task("lines", 500.0, (1,)))
        parting, tried = False, ()

        def perform(self, task, values, inbox):
            if self.parting:
                self.tried += (task,)
                raise TransientError(f"task {task} is late")
            return super().perform(task, values, inbox)

    bench = Bench(TwoTasks())
    with bench:
        bench.until(lambda: bench.safe.state == RESTING)
        bench.worker._may_leave = lambda: True
        bench.driver.parting = True
    assert bench.driver.tried[-2:] == (0, 1)
    told = [document["text"] for document in said if document["event"] == "unsafe"]
    assert told == [
        f"{name} was not given its safe values once more: task {k} is late"
        for k, name in enumerate(("voltages", "lines"))
    ]


@pytest.mark.parametrize("known_by", ["file", "image", "both, the file of another device"])
def test_the_next_worker_goes_on_from_what_the_device_was_given(said, tmp_path, known_by):
    """From the image, which the host keeps; from the file, when all processes were killed."""
    on_disk = known_by == "file"

    def memory(device="scripted"):
        return LastGiven.open(device, ("voltage", "feed_hold"), tmp_path)

    one = Bench(memory=memory() if on_disk else None)
    one.driver.errors = []
    with one:
        one.follow(80.0)
        one.driver.errors.append(ZeroDivisionError("killed"))
        one.until(lambda: one.bug is not None, 80.0)
    theirs = memory("theirs")
    theirs.write([10.0, 0.0])
    other = Bench(
        memory={"file": memory(), "image": None}.get(known_by, theirs), record=None if on_disk else one.record
    )
    with other:
        other.until(lambda: other.safe.state == RESTING)
    assert other.driver.given[0][0] == 80.0
    assert largest_step(other.driver, 80.0) <= STEP_V + 1e-9


def test_the_loop_is_told_that_the_device_rests_when_it_has_taken_that_and_not_before(bench):
    """A worker that stood still is behind: what the loop wants is at rest, what the device has is not."""
    bench.follow(40.0)
    bench.driver.outcome = Outcome.HELD
    for _ in range(20):
        assert bench.cycle(0.0) == AWAY
        time.sleep(0.002)
    bench.driver.outcome = None
    bench.until(lambda: bench.cycle(0.0) == 0)
    assert bench.driver.given[-1][0] == 0.0


def test_before_anything_else_is_sent_it_is_not_at_rest(bench):
    told = []
    bench.until(lambda: bench.cycle(0.0) == 0)
    bench.driver.before_each = lambda: told.append((bench.safe.values[0], bench.image.ask(AT_REST)))
    bench.follow(40.0)
    assert {rests for value, rests in told if value != 0.0} == {0}


def test_a_link_that_comes_back_is_not_at_rest_before_it_was_given_that(bench):
    bench.until(lambda: bench.cycle(0.0) == 0)
    bench.driver.outcome = Outcome.HELD
    bench.driver.errors.append(LinkError("cut"))
    bench.until(lambda: bench.driver.opened == 2 and bench.cycle(0.0) == TAKEN)
    rests = bench.image.ask(AT_REST)
    bench.driver.outcome = None
    assert rests == 0


def test_the_reason_is_told_before_the_state_that_it_is_the_reason_of(bench, monkeypatch):
    monkeypatch.setattr("micromanip.bus.worker._UNREACHED_S", 0.2)  # nobody waits for it to come back
    links = {}
    say = lambda **document: links.setdefault(document["event"], bench.image.link)  # noqa: E731
    monkeypatch.setattr("micromanip.bus.report.send_message", say)
    bench.follow(10.0)
    bench.driver.open_errors = [IdentityMismatch("it says E-727, not E-709")]
    bench.driver.errors.append(LinkError("unplugged"))
    bench.until(lambda: bench.image.link == "latched", 10.0)
    assert links["lost"] == "up"
    assert links["latched"] == "down"


def test_a_device_that_takes_its_time_to_open_is_neither_lost_nor_closed(bench):
    closed = []

    def close():
        closed.append(len(bench.driver.open_errors))
        bench.driver.closed = bench.driver.opened

    bench.driver.close = close
    bench.follow(10.0)
    bench.driver.open_errors = [StillOpening("boot loader")] * 10
    bench.driver.errors.append(LinkError("unplugged"))
    bench.until(lambda: not bench.driver.open_errors and bench.image.link == "up", 10.0)
    assert closed == [10], "once, before it was opened again"
    assert events(bench) == ["up", "lost", "up"]


def test_it_ends_while_its_device_takes_its_time(tmp_path, monkeypatch):
    monkeypatch.setattr("micromanip.bus.report.send_message", lambda **_: None)
    driver = ScriptedDriver()
    driver.open_errors = [StillOpening("for ever")] * 100_000
    worker = Worker(driver, ProcessImage(np.zeros(1, IMAGE)), RULES)
    thread = threading.Thread(target=worker.run)
    thread.start()
    worker.end()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert driver.open_errors, "it was not waited for"
