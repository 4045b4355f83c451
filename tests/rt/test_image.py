"""The process image: whole samples only, what a killed writer leaves behind, and when a link counts as up."""

import math
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus.image import ProcessImage
from micromanip.rt import bus_image as im
from micromanip.rt.bus_exchange import exchange_image
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL


def new(inputs=3, outputs=2, silent_ns=1000):
    image = np.zeros(1, im.IMAGE)
    image["inputs"], image["outputs"], image["silent_ns"] = inputs, outputs, silent_ns
    return image


def up(image, now_ns=0):
    worker = ProcessImage(image)
    worker.tell(im.EPOCH, worker.ask(im.EPOCH) + 1)
    worker.tell(im.ALIVE_NS, now_ns)
    worker.tell(im.LINK, im.LINK_UP)
    worker.tell(im.OUTPUT_STATE, im.FOLLOWING)
    worker.tell(im.AT_REST, 1)


def exchange(image, now_ns=0, outputs=None, signals=None):
    signals = np.zeros(MAX_SIGNALS, SIGNAL) if signals is None else signals
    given = np.zeros(MAX_OUTPUTS) if outputs is None else outputs
    return exchange_image(image[0], given, signals, now_ns), signals


def test_a_sample_taken_after_the_deadline_counts_as_taken_then():
    image = new()
    ProcessImage(image).publish_sample(0, 1.0, 950, 0, 0)
    assert exchange(image, 900)[1][0]["time_ns"] == 900


@given(st.lists(st.lists(st.floats(-200, 200), min_size=2, max_size=2), min_size=1, max_size=20))
def test_the_newest_outputs_are_taken(history):
    image = new()
    worker = ProcessImage(image)
    for k, outputs in enumerate(history):
        padded = np.zeros(MAX_OUTPUTS)
        padded[:2] = outputs
        exchange(image, k, padded)
    values, written_ns = worker.wanted()
    assert written_ns == len(history) - 1
    assert values[:2].tolist() == history[-1]


def test_a_half_written_sample_is_not_taken():
    image = new()
    ProcessImage(image).publish_sample(0, 1.0, 10, 0, 0)
    _, signals = exchange(image, 20)
    image[0]["input_turn"][0] |= 1  # the writer is in the middle, or was killed there
    image[0]["input"][0]["value"] = 99.0
    _, signals = exchange(image, 30, signals=signals)
    assert signals[0].tolist() == (1.0, 10, 1, 0)


def test_a_worker_that_takes_over_drops_what_was_half_written():
    image = new()
    ProcessImage(image).publish_sample(0, 1.0, 10, 0, 0)
    image[0]["input_turn"][0] |= 1
    image[0]["input"][0]["value"] = 99.0
    ProcessImage(image).take_over()
    _, signals = exchange(image, 20)
    assert (signals[0]["sequence"], signals[0]["status"]) == (1, im.DOWN)
    ProcessImage(image).publish_sample(0, 2.0, 30, 0, 0)
    _, signals = exchange(image, 40, signals=signals)
    assert signals[0].tolist() == (2.0, 30, 2, 0)


def test_outputs_that_are_just_being_written_are_not_taken():
    image = new()
    worker = ProcessImage(image)
    exchange(image, 5, np.full(MAX_OUTPUTS, 7.0))
    worker.wanted()
    exchange(image, 6, np.full(MAX_OUTPUTS, 8.0))
    image[0]["words"][im.OUTPUT_TURN] |= 1
    values, written_ns = worker.wanted()
    assert (values[:2].tolist(), written_ns) == ([7.0, 7.0], 5)


def test_the_link_is_down_until_it_has_held_a_cycle():
    image = new()
    assert exchange(image, 100)[0] == im.DOWN
    up(image, 100)
    assert exchange(image, 200)[0] == im.DOWN  # it has just come up: what was before is over
    assert exchange(image, 300)[0] == 0


def test_outputs_that_follow_are_at_rest_where_the_worker_says_so():
    for outputs, code in ((2, im.AWAY), (0, 0)):
        image = new(outputs=outputs)
        up(image, 100)
        exchange(image, 200)
        ProcessImage(image).tell(im.AT_REST, 0)
        assert exchange(image, 300)[0] == code
        ProcessImage(image).tell(im.AT_REST, 1)
        assert exchange(image, 400)[0] == 0


@pytest.mark.parametrize("state", [im.RESTING, im.SAFE_RAMP, im.UNKNOWN])
def test_outputs_that_do_not_follow_are_seen_in_the_very_next_cycle(state):
    image = new()
    up(image, 100)
    exchange(image, 200)
    assert exchange(image, 300)[0] == 0
    ProcessImage(image).tell(im.OUTPUT_STATE, state)
    assert exchange(image, 400)[0] == im.TAKEN
    ProcessImage(image).tell(im.LINK, im.LINK_DOWN)
    assert exchange(image, 500)[0] == im.DOWN  # the graver news
    bus_without_outputs = new(outputs=0)
    up(bus_without_outputs, 100)
    ProcessImage(bus_without_outputs).tell(im.OUTPUT_STATE, state)
    exchange(bus_without_outputs, 200)
    assert exchange(bus_without_outputs, 300)[0] == 0


def waiting(given=(5.0, -6.0), at_ns=1000):
    """An image whose outputs follow, given these in their turn at that time; each comes every 200 ns at least."""
    image = new(silent_ns=10**9)
    image["patience_ns"] = 200
    up(image, at_ns)
    exchange(image, at_ns)
    ProcessImage(image).remember_sent(given, at_ns)
    ProcessImage(image).tell_turn((0, 1), at_ns)
    return image


def left(image, now_ns):
    """What an exchange that asks for 8 and 9 leaves of these; the worker is asked for them all the same."""
    outputs = np.zeros(MAX_OUTPUTS)
    outputs[:2] = 8.0, 9.0
    exchange(image, now_ns, outputs)
    assert image[0]["value"][:2].tolist() == [8.0, 9.0]
    return outputs[:2].tolist()


def test_outputs_whose_turn_has_not_come_for_too_long_are_what_the_device_has():
    image = waiting()
    assert left(image, 1200) == [8.0, 9.0]
    assert left(image, 1201) == [5.0, -6.0]
    ProcessImage(image).tell_turn((1,), 1201)  # by the task of this one alone
    assert left(image, 1202) == [5.0, 9.0]
    ProcessImage(image).tell_turn((0,), 1203)
    assert left(image, 1401) == [8.0, 9.0]
    assert left(image, 1402) == [8.0, -6.0]


@pytest.mark.parametrize("state", [im.RESTING, im.SAFE_RAMP, im.UNKNOWN])
def test_no_output_waits_that_does_not_follow(state):
    image = waiting()
    ProcessImage(image).tell(im.OUTPUT_STATE, state)
    assert left(image, 5000) == [8.0, 9.0]
    ProcessImage(image).tell(im.OUTPUT_STATE, im.FOLLOWING)
    assert left(image, 5001) == [5.0, -6.0]
    ProcessImage(image).tell(im.LINK, im.LINK_DOWN)
    assert left(image, 5002) == [8.0, 9.0]


def test_a_value_that_nobody_knows_is_not_put_in_place_of_an_output():
    assert left(waiting((math.nan, -6.0)), 5000) == [8.0, -6.0]


def test_a_silent_worker_is_a_lost_link():
    image = new(silent_ns=1000)
    up(image, 100)
    exchange(image, 200)
    assert [exchange(image, now_ns)[0] for now_ns in range(300, 1300, 100)] == [0] * 10
    assert exchange(image, 1201)[0] == im.DOWN


def test_a_loop_that_stood_still_gives_the_worker_time_to_come_back():
    """What held up the one may have held up the other: this computer stood still, and no link is lost."""
    image = new(silent_ns=1000)
    up(image, 100)
    exchange(image, 200)
    assert exchange(image, 90_200)[0] == 0
    assert exchange(image, 90_700)[0] == 0
    assert exchange(image, 90_701)[0] == im.DOWN, "it has not come back"
    ProcessImage(image).tell(im.ALIVE_NS, 90_750)
    assert exchange(image, 90_800)[0] == 0


def test_a_link_that_came_back_between_two_cycles_was_lost_all_the_same():
    image = new()
    up(image, 100)
    exchange(image, 200)
    assert exchange(image, 300)[0] == 0
    ProcessImage(image).tell(im.LINK, im.LINK_DOWN)
    up(image, 310)
    assert exchange(image, 400)[0] == im.DOWN
    assert exchange(image, 500)[0] == 0


@pytest.mark.compiled_only
def test_no_reader_ever_sees_half_a_sample():
    """A writer in another thread, without the interpreter's lock: value and time always belong together."""
    image, ends = new(), threading.Event()
    worker = ProcessImage(image)

    def write():
        k = 0
        while not ends.is_set():
            k += 1
            worker.publish_sample(0, float(k), k)

    writer = threading.Thread(target=write)
    writer.start()
    signals, seen = np.zeros(MAX_SIGNALS, SIGNAL), set()
    try:
        reads, until_s = 0, time.monotonic() + 60.0
        while reads < 20000 or (len(seen) <= 10 and time.monotonic() < until_s):  # the writer needs its turns, too
            exchange(image, 1 << 60, signals=signals)
            assert signals[0]["value"] == signals[0]["time_ns"] == signals[0]["sequence"]
            seen.add(int(signals[0]["sequence"]))
            reads += 1
    finally:
        ends.set()
        writer.join()
    assert len(seen) > 10
