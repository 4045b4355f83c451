"""On the wire: whichever turn is taken, Python's or the compiled one, no output steps, and none moves that may not."""

import ctypes
import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus.beginning import place
from micromanip.bus.cyclic import EXCHANGE_C
from micromanip.bus.driver import Outcome, Task
from micromanip.bus.errors import LinkError, TransientError
from micromanip.bus.image import ProcessImage
from micromanip.bus.inbox import Inbox
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import LAST_SWITCH, SWITCH, UNUSED, VOLTAGE, OutputWriter, SafeOutput, SafeState
from micromanip.bus.schedule import Schedule
from micromanip.bus.watchdog import Watchdog
from micromanip.rt.bus_image import FOLLOWING, IMAGE, OUTPUT_STATE, OUTPUT_TURN, RESTING, SAFE_RAMP, WRITTEN_NS
from micromanip.rt.io import worker_loop
from micromanip.rt.io.worker_records import (
    ASKED,
    INBOX,
    MEMORY,
    NOTHING_SENT,
    ON_THE_RAMP,
    SENT_IN_DOUBT,
    SERVICE,
    SILENT,
    UNCONFIRMED,
)

RATE_HZ, DEAD_NS, BEGINS_NS, FRESH_NS = 2000.0, 10**8, 10**12, 10**10
OUTPUTS = (
    SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, 10.0 * RATE_HZ),
    SafeOutput(SWITCH, 1.0, 0.0, 1.0),
    SafeOutput(VOLTAGE, 10.0, -20.0, 150.0, 2.0 * RATE_HZ),
    SafeOutput(LAST_SWITCH, 0.0, 0.0, 1.0),
    SafeOutput(UNUSED, 7.0),
)
TASKS = (Task("first", RATE_HZ, (0, 1)), Task("second", RATE_HZ, (2, 3, 4)))
SAFE = [output.safe for output in OUTPUTS]
STEP_V = {0: 10.0, 2: 2.0}
WATCHDOG = Watchdog(ms=1000.0, rest_ms=1.0, after_power_on="rest")
KEEPS = Watchdog(ms=None, after_power_on="last")
CODES = {"taken": 0, "sent": UNCONFIRMED, "held": NOTHING_SENT, "arrived": SENT_IN_DOUBT, "lost": SENT_IN_DOUBT}


class Cell:
    """Image, gate and schedule, which both turns share, and a device that looks at all that it gets."""

    def __init__(self, memory=None):
        self.tasks, self.memory = TASKS, memory
        self.safe = SafeState(OUTPUTS, TASKS, 0.005, DEAD_NS, SAFE, BEGINS_NS)
        self.safe.assume_safe()
        self.record = np.zeros(1, IMAGE)
        self.record["outputs"] = len(OUTPUTS)
        self.image, self.inbox = ProcessImage(self.record), Inbox()
        self.writer = OutputWriter(self, self.safe, lambda last: self.image.remember_sent(last, time.monotonic_ns()))
        self.schedule = Schedule(TASKS, time.monotonic_ns())
        self.has, self.may_move, self.outcome, self.on_the_way = list(SAFE), False, "taken", set()
        self.wrong = []  # an exception would be lost in compiled code
        self.service, self.samples = np.zeros(1, SERVICE), np.zeros(1, INBOX)
        self.functions = EXCHANGE_C(self.receive_c), EXCHANGE_C(self.send_c)
        addresses = [ctypes.cast(function, ctypes.c_void_p).value for function in self.functions]
        self.service["receive"], self.service["send"] = addresses
        self.service["descriptor"], self.service["look_ns"], self.service["until_ns"] = -1, 10**6, 1 << 62

    def gets(self, task, values):
        """The device is sent that: whatever it does with it, it must be near to what it has."""
        for i in TASKS[task].outputs:
            in_range = OUTPUTS[i].low <= values[i] <= OUTPUTS[i].high
            near = i not in STEP_V or abs(values[i] - self.has[i]) <= STEP_V[i] + 1e-9
            wider = i in STEP_V and abs(values[i] - SAFE[i]) > abs(self.has[i] - SAFE[i]) + 1e-9
            if not in_range or (self.outcome != "held" and (not near or (wider and not self.may_move))):
                self.wrong.append((i, values[i], self.has[i], self.may_move))
        if self.outcome in ("taken", "sent", "arrived"):
            for i in TASKS[task].outputs:
                self.has[i] = values[i]
        if self.outcome == "sent":
            self.on_the_way.add(task)

    def perform(self, task, values, inbox):
        """The driver's, in Python."""
        self.gets(task, values)
        if self.outcome in ("arrived", "lost"):
            raise TransientError("nobody knows")
        return {"taken": None, "sent": Outcome.SENT, "held": Outcome.HELD}[self.outcome]

    def send_c(self, context, values, inbox, now_ns, task):
        self.gets(task, np.ctypeslib.as_array(ctypes.cast(values, ctypes.POINTER(ctypes.c_double)), (5,)).tolist())
        self.service[0]["leave"][0] = 1
        return CODES[self.outcome]

    def receive_c(self, context, values, inbox, now_ns, task):
        for k in self.on_the_way:
            self.samples[0]["confirmed"][k] = 1
        self.on_the_way.clear()
        return 0

    def want(self, wanted, age_ns=-FRESH_NS):
        """The loop's outputs; fresh for a while, so that a test that stands still does not play a dead loop."""
        self.record["value"][0][:5] = wanted
        self.record["words"][0][WRITTEN_NS] = time.monotonic_ns() - age_ns
        rests = all(abs(wanted[i] - SAFE[i]) <= 1e-9 for i in STEP_V)
        self.may_move = age_ns < 0 and (self.may_move or (rests and self.safe.state == RESTING))

    def python_turn(self):
        while (task := self.schedule.take(time.monotonic_ns())) is None:
            time.sleep(1e-4)
        wanted, written_ns = self.image.wanted()
        self.safe.decide(wanted[:5].tolist(), written_ns, time.monotonic_ns())
        for k in self.on_the_way:
            self.inbox.confirm(k)
        self.on_the_way.clear()
        self.writer.take_confirmed(self.inbox)
        try:
            self.writer.perform(task, self.inbox)
        except TransientError:
            self.schedule.failed(task)

    def compiled_turn(self):
        """Until something was sent; why it ended."""
        self.service[0]["leave"][0] = 0
        memory = np.zeros(1, MEMORY) if self.memory is None else self.memory.record
        memory["file"] = -1 if self.memory is None else memory["file"]
        records = self.service, self.safe.record, self.schedule.record, self.record, self.samples, memory
        return worker_loop.serve(*records)

    def turn(self, compiled):
        if not compiled or self.safe.state == SAFE_RAMP:
            self.python_turn()
        elif self.compiled_turn() == ON_THE_RAMP:
            assert self.safe.state == self.image.ask(OUTPUT_STATE) == SAFE_RAMP
        assert self.wrong == []

    def follow(self):
        """Into the loop's hand, as an operator does."""
        while self.safe.state != FOLLOWING:
            self.want(SAFE)
            self.turn(False)


acts = st.tuples(
    st.sampled_from(["taken", "taken", "sent", "held", "arrived", "lost", "dead", "cut", "silent"]),
    st.tuples(
        *[st.one_of(st.floats(-30.0, 160.0), st.sampled_from([0.0, 10.0, math.nan, math.inf]))] * 3,
        *[st.sampled_from([0.0, 1.0, math.nan])] * 2,
    ),
    st.booleans(),
)


@given(st.lists(acts, min_size=1, max_size=40))
def test_no_output_steps_and_none_moves_that_may_not(steps):
    cell = Cell()
    cell.follow()
    for what, wanted, compiled in steps:
        cell.outcome = what if what in CODES else "taken"
        if what in ("cut", "silent"):
            now_ns = time.monotonic_ns()
            if what == "silent":  # so long that the device has gone to rest by itself
                cell.has = [SAFE[i] if i in STEP_V else has for i, has in enumerate(cell.has)]
                now_ns = cell.writer.touched_ns + WATCHDOG.still_ns
            cell.writer.forget()
            cell.on_the_way.clear()
            cell.safe.leave()
            cell.may_move = False
            assert place(cell.safe, KEEPS if what == "cut" else WATCHDOG, now_ns, [None] * 5) == []
        cell.want(wanted, 2 * DEAD_NS if what == "dead" else -FRESH_NS)
        cell.turn(compiled)
        if cell.safe.state == RESTING:
            assert all(abs(cell.has[i] - SAFE[i]) <= 1e-9 for i in STEP_V)
    cell.outcome = "taken"
    for _ in range(1000):
        cell.want(SAFE, 2 * DEAD_NS)
        cell.turn(True)
        if cell.safe.state == RESTING:
            break
    assert all(abs(cell.has[i] - SAFE[i]) <= 1e-9 for i in STEP_V), "it comes to rest whatever was before"


def test_a_device_that_was_silent_for_too_long_is_given_nothing_more():
    """By neither turn: it may be anywhere between what it was given and rest."""
    cell = Cell()
    cell.follow()
    while cell.has[0] < 50.0 or cell.has[2] < 20.0:
        cell.want([60.0, 0.0, 30.0, 0.0, 0.0])
        cell.turn(False)
    sent = []
    cell.gets = lambda task, values: sent.append(task)
    cell.safe.fields["fed_ns"][0] = cell.safe.fields["fed_ns"][1] = time.monotonic_ns() - 2 * BEGINS_NS
    assert cell.compiled_turn() == SILENT
    with pytest.raises(LinkError, match=r"watchdog\.ms"):
        cell.writer.perform(0, cell.inbox)
    assert sent == []
    cell.writer.found_still()
    assert cell.compiled_turn() == ASKED
    assert len(sent) == 1, "its watchdog has had its time"


def test_a_write_that_is_owed_comes_before_a_read_in_either_turn():
    """A read that always fails, and that was due for longer, keeps no write from its turn."""
    cell = Cell()
    cell.follow()
    tasks = (Task("read", RATE_HZ), TASKS[1], TASKS[0])
    cell.schedule, now_ns = Schedule(tasks, time.monotonic_ns()), time.monotonic_ns()
    cell.schedule.failed(0)
    sent = []
    cell.gets = lambda task, values: sent.append(task)
    for _ in range(3):
        cell.safe.decide(SAFE, now_ns, now_ns)
        cell.want(SAFE)
        cell.compiled_turn()
    assert sent[:3] == [1, 2, 0]


def test_what_was_sent_after_a_confirmation_is_not_confirmed_by_it():
    """A driver that meets the answer to its last frame on the way to its next one."""
    cell = Cell()
    cell.follow()
    cell.outcome = "sent"
    cell.perform = lambda task, values, inbox: (inbox.confirm(0), Outcome.SENT)[1]
    for volts in (8.0, 16.0):
        cell.safe.decide([volts, 0.0, 10.0, 0.0, 0.0], time.monotonic_ns(), time.monotonic_ns())
        cell.writer.perform(0, cell.inbox)
    assert cell.writer.take_confirmed(cell.inbox) == [0, 0]
    assert cell.safe.last[0] == 8.0, "the device may still have that"


def test_what_the_loop_is_just_writing_is_not_taken():
    cell = Cell()
    cell.follow()
    cell.want([5.0, 0.0, 10.0, 0.0, 0.0])
    cell.compiled_turn()
    cell.want([9.0, 0.0, 10.0, 0.0, 0.0])
    cell.record["words"][0][OUTPUT_TURN] = 1
    cell.compiled_turn()
    assert cell.safe.fields["wanted"][0] == 5.0


def test_a_worker_that_is_killed_is_followed_from_what_was_given_last(tmp_path):
    """By the image, and by the file that outlives everything; Python and compiled code write it in turns."""
    names = [f"output{i}" for i in range(len(OUTPUTS))]
    memory = LastGiven.open("a device", names, tmp_path)
    memory.write([1.0, 2.0, 0.0, 0.0, math.nan])
    cell = Cell(memory)
    cell.follow()
    for volts in (3.0, 4.0, 5.0):
        cell.want([volts, 1.0, 11.0, 0.0, 0.0])
        cell.compiled_turn()
        cell.compiled_turn()
        expected = [volts, 1.0, 11.0, 0.0, 7.0]
        assert LastGiven.open("a device", names, tmp_path).read() == expected
        assert ProcessImage(cell.record).known(len(OUTPUTS)) == expected
    memory.write([9.0] * len(OUTPUTS))
    assert LastGiven.open("a device", names, tmp_path).read() == [9.0] * len(OUTPUTS)
    memory.close()
