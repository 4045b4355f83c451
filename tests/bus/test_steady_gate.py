"""The gate of the compiled loop lets through what the worker's own does, value for value, and remembers the same."""

import math
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus.image import ProcessImage
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import LAST_SWITCH, SWITCH, UNUSED, VOLTAGE, SafeOutput, SafeState
from micromanip.rt.bus_image import FOLLOWING, IMAGE, RESTING
from micromanip.rt.steady.gate import (
    decide,
    note_given,
    note_sent,
    rests,
    state_holds,
    take_confirmed,
    take_wanted,
)
from micromanip.rt.steady.records import INBOX, STEADY

NOW_NS, DEAD_NS = 10**12, 10**8
OUTPUTS = (
    SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, 5000.0),
    SafeOutput(VOLTAGE, 10.0, -20.0, 150.0, 1000.0),
    SafeOutput(SWITCH, 1.0, 0.0, 1.0),
    SafeOutput(LAST_SWITCH, 0.0, 0.0, 1.0),
    SafeOutput(UNUSED, 7.0),
)
SAFE = [output.safe for output in OUTPUTS]
EVERY = range(len(OUTPUTS))
TASKS = ((0, 2), (1, 3, 4))
NONE = np.zeros(0, np.int64), np.zeros(0)
OUTCOMES = ("first", "second", "in doubt", "held", "sent", "confirmed")

wanted = st.tuples(
    *[st.one_of(st.floats(-30.0, 160.0), st.sampled_from([0.0, 10.0, math.nan, math.inf, 1e-10]))] * 2,
    *[st.sampled_from([0.0, 1.0, 2.0, math.nan])] * 2,
    st.floats(-1.0, 1.0),
)


def resting():
    safe = SafeState(OUTPUTS, [0.002] * len(OUTPUTS), 0.1, DEAD_NS)
    safe.given(EVERY, SAFE)
    assert safe.state == RESTING
    return safe


def following():
    safe = resting()
    safe.values(SAFE, NOW_NS, NOW_NS)
    assert safe.state == FOLLOWING
    return safe


def lent(safe):
    record = np.zeros(1, STEADY)[0]
    record["outputs"], record["tasks"], record["following"] = len(OUTPUTS), len(TASKS), safe.state == FOLLOWING
    for task, outputs in zip(record["task"], TASKS, strict=False):
        task["outputs"], task["output"][: len(outputs)] = len(outputs), outputs
    safe.lend(record)
    return record


@given(st.lists(st.tuples(wanted, st.sampled_from(OUTCOMES)), min_size=1, max_size=20))
def test_values_that_follow_are_the_same(steps):
    safe, image, inbox = following(), np.zeros(1, IMAGE)[0], np.zeros(1, INBOX)[0]
    record, sent = lent(safe), None
    refused = safe.refused
    for asked, outcome in steps:
        record["wanted"][: len(asked)] = asked
        values = safe.values(asked, NOW_NS, NOW_NS)
        decide(record)
        assert record["value"][: len(values)].tolist() == values
        assert bool(rests(record)) == safe.rests_with(values)
        assert safe.refused - refused == record["refused"]
        if outcome == "in doubt":
            safe.attempted(TASKS[0], values)
            record, refused, sent = lent(safe), safe.refused, None  # a new stay in the compiled loop
        elif outcome == "sent":
            sent = values
            safe.attempted(TASKS[0], values)
            note_sent(record, 0, NOW_NS)
        elif outcome == "confirmed":
            inbox["confirmed"][0] = 1
            take_confirmed(record, image, inbox, *NONE, NOW_NS)
            if sent is not None:
                safe.given(TASKS[0], sent)
                assert image["sent"][: len(EVERY)].tolist() == safe.last
            sent = None
        elif outcome != "held":
            task = int(outcome == "second")
            safe.given(TASKS[task], values)
            note_given(record, image, *NONE, task, record["value"], NOW_NS, NOW_NS)
            assert image["sent"][: len(EVERY)].tolist() == safe.last


@given(wanted, st.booleans(), st.booleans())
def test_it_holds_as_long_as_the_state_does(asked, follows, dead):
    safe = following() if follows else resting()
    record, before = lent(safe), safe.state
    record["wanted"][: len(asked)] = asked
    record["written_ns"] = NOW_NS - (DEAD_NS + 1 if dead else 0)
    holds = bool(state_holds(record, NOW_NS))
    values = safe.values(asked, int(record["written_ns"]), NOW_NS)
    assert holds == (safe.state == before)
    if holds and not follows:
        decide(record)
        assert record["value"][: len(values)].tolist() == values == SAFE


def test_what_the_loop_is_just_writing_is_not_taken():
    image = np.zeros(1, IMAGE)
    image["outputs"] = len(OUTPUTS)
    record = lent(following())
    image["value"][0][:2], image["words"][0][1] = (5.0, 6.0), 77
    take_wanted(record, image[0])
    assert (record["wanted"][:2].tolist(), int(record["written_ns"])) == ([5.0, 6.0], 77)
    image["value"][0][:2], image["words"][0][:2] = (8.0, 9.0), (1, 78)
    take_wanted(record, image[0])
    assert (record["wanted"][:2].tolist(), int(record["written_ns"])) == ([5.0, 6.0], 77)


def test_a_worker_that_is_killed_is_followed_from_what_was_given_last(tmp_path: Path):
    """By the image, and by the file that outlives everything; Python and compiled code write it in turns."""
    names = [f"output{i}" for i in EVERY]
    memory, image = LastGiven.open("a device", names, tmp_path), np.zeros(1, IMAGE)
    image["outputs"] = len(OUTPUTS)
    memory.write([1.0, 2.0, 0.0, 0.0, math.nan])
    record = lent(following())
    for volts in (3.0, 4.0, 5.0):
        record["wanted"][: len(OUTPUTS)] = (volts, 11.0, 1.0, 0.0, 0.0)
        decide(record)
        slot = memory.lend(record)
        for task in (0, 1):
            note_given(record, image[0], *slot, task, record["value"], NOW_NS, NOW_NS)
        memory.turn = int(record["memory_turn"])
        expected = [volts, 11.0, 1.0, 0.0, 7.0]
        assert LastGiven.open("a device", names, tmp_path).read() == expected
        assert ProcessImage(image).known(len(OUTPUTS)) == expected
    memory.write([9.0] * len(OUTPUTS))
    assert LastGiven.open("a device", names, tmp_path).read() == [9.0] * len(OUTPUTS)
    memory.close()
