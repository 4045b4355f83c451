"""Time-outs, late answers, exceptions and rubbish: what is raised, and that no answer is taken for another's."""

import contextlib
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micromanip.bus.driver import Outcome
from micromanip.bus.errors import DeviceFault, LinkError, TransientError

from .scripted import READ, Scripted

pytestmark = pytest.mark.realtime  # an answer is late by milliseconds

BOTH = pytest.mark.parametrize("serial", [True, False], ids=["rtu", "tcp"])


def late(seconds):
    return lambda frame, request: [(seconds, frame)]


def instead(pdu):
    return lambda frame, request: [(0.0, request.seal(pdu))]


def never(frame, request):
    return []


def turns(scripted, seconds):
    """Turn for so long; the values that came, and the errors."""
    values, errors, end = [], [], time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            values += scripted.turn(wait_ns=5_000_000)
        except TransientError as problem:
            errors.append(str(problem))
            time.sleep(0.002)
    return values, errors


@given(st.lists(st.floats(0.0, 0.05), min_size=1, max_size=6), st.booleans())
@settings(max_examples=15)
def test_whatever_is_late_every_value_is_that_of_its_own_request(delays_s, serial):
    """The unit is never later than the line is kept silent for; how late it is differs each time."""
    scripted = Scripted(serial=serial)
    scripted.unit.said = {2 + i: late(delay_s) for i, delay_s in enumerate(delays_s)}
    for _ in range(len(delays_s) + 3):
        asked = scripted.unit.requests
        try:
            values = scripted.turn()
        except TransientError:
            time.sleep(0.02)
            continue
        except LinkError:
            scripted.driver.close()
            scripted.driver.open()
            continue
        if scripted.unit.requests == asked:  # held back
            time.sleep(0.02)
            continue
        assert values == [asked + 1]


def test_nothing_is_sent_on_a_serial_line_while_late_answers_are_waited_for():
    scripted = Scripted(serial=True)
    scripted.unit.said[2] = never
    with pytest.raises(TransientError, match="no answer within"):
        scripted.turn()
    asked, begin = scripted.unit.requests, time.monotonic()
    assert scripted.driver.perform(0, (), scripted.inbox) is Outcome.HELD
    assert scripted.unit.requests == asked
    while scripted.unit.requests == asked:
        scripted.turn(wait_ns=1_000_000)
    assert time.monotonic() - begin > 0.038


@BOTH
def test_the_late_answer_itself_ends_the_silence_once(serial):
    scripted = Scripted(serial=serial, drain_ms=600)
    scripted.unit.said[2] = late(0.03)
    with pytest.raises(TransientError):
        scripted.turn()
    time.sleep(0.02)
    assert scripted.turn() == [3.0]
    assert scripted.driver.statistics()["late"] == 1


@BOTH
@pytest.mark.parametrize(
    ("code", "error", "said"),
    [
        (1, DeviceFault, "illegal function"),
        (2, DeviceFault, "address_base"),
        (4, DeviceFault, "device failure"),
        (6, TransientError, "busy"),
        (11, TransientError, "behind the gateway"),
        (99, DeviceFault, "of the vendor"),
    ],
)
def test_exceptions(serial, code, error, said):
    scripted = Scripted(serial=serial)
    scripted.unit.said[2] = instead(bytes((0x83, code)))
    with pytest.raises(error, match=rf"u \(unit 1\), function 3, 5: exception {code}, .*{said}"):
        scripted.turn()
    assert scripted.turn() == [3.0], "the next one is asked for at once"


def test_after_rubbish_a_serial_line_is_found_again():
    scripted = Scripted(serial=True)
    scripted.unit.said[2] = lambda frame, request: [(0.0, b"\x55\xaa\x17\x55\xaa\x17"), (0.003, frame)]
    with pytest.raises(TransientError, match="no answer but something else"):
        scripted.turn()
    values, _ = turns(scripted, 0.1)
    assert values, "it goes on"
    assert 2.0 not in values
    assert values[-1] == scripted.unit.requests


def test_an_echo_is_named():
    scripted = Scripted(serial=True)
    scripted.unit.said[2] = lambda frame, request: [(0.0, RTU_REQUEST), (0.002, frame)]
    with pytest.raises(TransientError, match=r"rs485: \{echo: true\}"):
        scripted.turn()


RTU_REQUEST = bytes.fromhex("01 03 0005 0001 940b")


@BOTH
def test_two_units_on_one_line_never_get_each_others_answers(serial):
    task = {"ask": {"function": 3, "rate_hz": 20, "read": READ}}
    one = {"address_base": 0, "byte_order": "big", "word_order": "big", "tasks": task}
    scripted = Scripted(serial=serial, units={"a": {"unit_id": 1, **one}, "b": {"unit_id": 2, **one}})
    scripted.unit.said[3] = late(0.025)  # each was greeted once
    with pytest.raises(TransientError, match=r"a \(unit 1\)"):
        scripted.turn(task=0)
    values = []
    while not values:
        asked = scripted.unit.requests
        try:
            values = scripted.turn(task=1)
        except TransientError:
            time.sleep(0.002)
    assert values == [asked + 1]
    assert [scripted.driver.inputs[sample.channel].name for sample in scripted.inbox] == ["b.value"]


def test_after_a_second_time_out_in_a_row_the_silence_is_waited_for():
    """The late answer may be that to the request before."""
    scripted = Scripted(serial=True, drain_ms=60)
    scripted.unit.said |= {2: never, 3: late(0.025)}
    while scripted.driver.statistics()["timeouts"] < 2:
        with contextlib.suppress(TransientError):
            scripted.turn()
        time.sleep(0.001)
    time.sleep(0.015)
    assert scripted.driver.perform(0, (), scripted.inbox) is Outcome.HELD
    assert turns(scripted, 0.15)[0][-1] == scripted.unit.requests
