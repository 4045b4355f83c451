"""Compiled functions and Python say the same of every frame, bit for bit; what is out of the ordinary is Python's."""

import random
from types import SimpleNamespace

import can
import pytest
from can.interfaces.socketcan.socketcan import build_can_frame
from cantools.database.can import Message, Signal
from hypothesis import assume, given
from hypothesis import strategies as st
from micromanip_drivers.canbus.messages import ReceivedMessage, SentMessage
from micromanip_drivers.canbus.options import Received, Sent

from micromanip.bus.inbox import Inbox
from micromanip.errors import ConfigError
from micromanip.rt.io.worker_records import NOTHING_SENT
from micromanip.rt.records import MAX_OUTPUTS

from ..compiled_turns import assert_sent_alike, bits
from .compiled_socket import compiled
from .layouts import messages

pytestmark = pytest.mark.compiled_only


def plain(message, most=12):
    """A message of random layout, with an identifier of its own; `most` signals of it."""
    return Message(
        frame_id=message.frame_id, name="M", length=message.length, signals=message.signals[:most], is_fd=message.is_fd
    )


def received(message, **options):
    return ReceivedMessage(message, Received(rate_hz=100.0, **options), 0, 1e-4)


def sent(message, **options):
    resting = SimpleNamespace(**{name: getattr(message, name) for name in ("name", "signals", "length", "frame_id")})
    resting.is_extended_frame, resting.is_fd, resting.dbc = message.is_extended_frame, message.is_fd, None
    return SentMessage(resting, Sent(rate_hz=100.0, **options), 0, 1e-4)


def frame(message, data, **flags):
    return can.Message(
        arbitration_id=message.frame_id,
        is_extended_id=message.is_extended_frame,
        is_fd=message.is_fd,
        bitrate_switch=message.is_fd,
        data=data,
        **flags,
    )


def interesting(draw, length):
    """Bytes at random, or such that the ends of ranges come up."""
    return draw.choice([draw.randbytes(length), bytes(length), b"\xff" * length, b"\x80" + bytes(length - 1)])


@given(messages(), st.integers(0, 2**32))
def test_any_frame_is_unpacked_the_same(message, seed):
    ours, draw = received(plain(message)), random.Random(seed)
    with compiled([ours]) as at:
        for _ in range(4):
            data = interesting(draw, message.length)
            inbox = Inbox()
            ours.take(data, 0, inbox)
            at.arrives(frame(message, data))
            assert at.receive() == 0
            assert bits(at.samples(len(inbox))) == bits([sample.value for sample in inbox])


@given(messages(), st.integers(0, 2**32))
def test_any_values_are_packed_the_same_or_refused_the_same(message, seed):
    message, draw = plain(message, MAX_OUTPUTS), random.Random(seed)
    try:
        ours = sent(message)
    except ConfigError:  # a signal that can't be at rest: nothing is ever sent
        assume(False)
    fields = [(field, None if field.floating else (field.low, field.high)) for field in ours.fields]
    with compiled([], [ours]) as at:
        assert_sent_alike(draw, fields, lambda values: build_can_frame(ours.frame(values)), at.send, at.heard)


def counting():
    return Message(
        frame_id=0x123,
        name="M",
        length=4,
        signals=[Signal("value", 0, 8), Signal("Status", 8, 8), Signal("Count", 16, 4, maximum=14)],
    )


@given(st.lists(st.tuples(st.integers(0, 15), st.integers(0, 3), st.integers(0, 255)), max_size=40))
def test_counter_and_status_are_judged_the_same(frames):
    """Also where compiled functions and Python take turns: both go on from where the other is."""
    options = {"counter": "Count", "status": {"signal": "Status", "good": (1, 2)}}
    reference, shared = received(counting(), **options), received(counting(), **options)
    message, theirs, ours = counting(), Inbox(), Inbox()
    with compiled([shared]) as at:
        for number, (count, status, value) in enumerate(frames):
            data = bytes([value, status, count, 0])
            reference.take(data, 0, theirs)
            if number % 3 == 2:
                shared.take(data, 0, ours)
            else:
                at.arrives(frame(message, data))
                assert at.receive() == 0
        assert len(theirs) == len(ours) + int(at.inbox[0]["received"])
        assert theirs.lost == ours.lost + int(at.inbox[0]["lost"])
        assert at.inbox[0]["missing"].sum() == at.inbox[0]["lost"]
        row = at.inbox[0]["signal"][0]
        assert row["sequence"] == at.inbox[0]["received"] + at.inbox[0]["missing"][0]
        for name in ("lost", "doubled", "late", "restarts"):
            assert shared.counter.counted(name) == reference.counter.counted(name)


def test_a_count_begins_anew_behind_its_maximum():
    """As in AUTOSAR's profile 1, where 15 is no count."""
    message, inbox = received(counting(), counter="Count"), Inbox()
    for k in range(40):
        message.take(bytes([7, 1, k % 15, 0]), 0, inbox)
    assert (len(inbox), message.counter.counted("lost")) == (80, 0)


def test_what_is_out_of_the_ordinary_is_left_to_python_and_the_rest_is_taken():
    mine, theirs = received(counting()), sent(command())
    odd = [
        frame(counting(), b"ab"),  # too short
        can.Message(arbitration_id=0x40, is_extended_id=False, is_error_frame=True, data=bytes(8)),
        can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=4),
        frame(command(), b"a"),  # one of our own commands, from somebody else
    ]
    with compiled([mine], [theirs]) as at:
        at.arrives(frame(counting(), bytes([1, 0, 0, 0])))
        for one in odd:
            at.arrives(one)
        at.arrives(can.Message(arbitration_id=0x123, is_extended_id=True, data=bytes(8)))  # nobody's
        at.arrives(frame(counting(), bytes([2, 0, 0, 0, 5])))  # longer than it should be
        assert at.receive() == 1
        assert at.samples(1) == [2.0]
        assert at.inbox[0]["signal"][0]["sequence"] == 2
        assert (at.tables.counted("frames_in"), at.tables.counted("not_ours")) == (3, 1)
        assert at.receive() == 1, "it takes nothing more before Python has taken what it left"
        assert at.send([1.0]) == NOTHING_SENT
        left = [message for message, _ in at.tables.left()]
        assert [(m.arbitration_id, m.is_error_frame, m.is_remote_frame, bytes(m.data)) for m in left] == [
            (m.arbitration_id, m.is_error_frame, m.is_remote_frame, bytes(m.data)) for m in odd
        ]
        assert at.tables.left() == []
        assert at.receive() == 0
        assert at.send([1.0]) == 0


def command():
    return Message(frame_id=0x100, name="C", length=1, signals=[Signal("value", 0, 8)])


def test_a_full_queue_is_tried_again_by_python_and_leaves_no_gap():
    message = Message(
        frame_id=0x100, name="C", length=2, signals=[Signal("value", 0, 8), Signal("Count", 8, 8, maximum=14)]
    )
    with compiled([], [sent(message, counter="Count")]) as at:
        taken = 0
        while at.send([1.0]) == 0:
            taken += 1
        assert at.tables.error("send_error") is None
        at.far.recv(256)
        assert at.send([1.0]) == 0
        counts = [packet[9] for packet in iter(at.heard, None)]
        assert counts == [k % 15 for k in range(1, taken + 1)]
