"""The tables' codec beside plain Python's: the same bits from the same description, whatever it is."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus.frame_plan import FramePlan, GroupPlan
from micromanip.rt.io.frames import (
    GOOD,
    NOT_THIS_FRAME,
    WRONG_CHECKSUM,
    WRONG_LENGTH,
    begin_frame,
    code_of,
    judged,
    put_value,
    seal,
    status_of,
    value_of,
)

from .frames import CHECKSUMS, Checksum, Field, frame_descriptions


def planned(description):
    head, counter, status, fields, check, length = description
    group = GroupPlan({f"field_{i}": field for i, field in enumerate(fields)})
    return FramePlan(length, [group], head, check, counter, None, status).record()[0]


def same(found, expected):
    return struct.pack("<d", found) == struct.pack("<d", expected) or (math.isnan(found) and math.isnan(expected))


def as_array(data):
    return np.frombuffer(bytes(data), np.uint8).copy()


@given(frame_descriptions(), st.data())
def test_what_comes_is_read_alike(description, data):
    _, counter, status, fields, _, length = description
    frame = planned(description)
    raw = data.draw(st.binary(min_size=length, max_size=length))
    came = as_array(raw)
    for number, field in zip(frame["number"], fields, strict=False):
        with np.errstate(all="ignore"):
            assert same(float(value_of(frame, number, came)), field.value(raw))
    if counter is not None:
        assert int(code_of(frame["counter"], came)) == counter.code(raw)
    assert status_of(frame, came) == (status.word(raw) if status is not None else 0)


@given(frame_descriptions(), st.data())
def test_what_is_sent_is_written_alike(description, data):
    head, counter, _, fields, check, length = description
    frame = planned(description)
    expected = bytearray(length)
    expected[: len(head)] = head
    count = data.draw(st.integers(0, 255))
    written = np.full(length, 0xAA, np.uint8)
    begin_frame(frame, written, count)
    if counter is not None:
        expected[counter.at : counter.at + counter.size] = count.to_bytes(counter.size, counter.byte_order)
    for number, field in zip(frame["number"], fields, strict=False):
        low, high = field.range or (number["low"], number["high"])
        value = data.draw(st.floats(low, high) | st.floats() | st.sampled_from([low, high, field.offset]))
        with np.errstate(all="ignore"):
            assert put_value(frame, number, written, value) == field.put(expected, value)
    seal(frame, written)
    if check is not None:
        expected[length - check.size :] = check.of(expected)
    assert written.tobytes() == bytes(expected)


@given(frame_descriptions(), st.data())
def test_only_the_frame_that_is_described_passes(description, data):
    head, _, _, _, check, length = description
    frame = planned(description)
    raw = bytearray(data.draw(st.binary(min_size=length, max_size=length)))
    raw[: len(head)] = head
    if check is not None:
        raw[length - check.size :] = check.of(raw)
    assert judged(frame, as_array(raw), length) == GOOD
    other = data.draw(st.integers(0, 1472).filter(lambda count: count != length))
    assert judged(frame, np.zeros(1472, np.uint8), other) == WRONG_LENGTH
    spoilt = bytearray(raw)
    spoilt[data.draw(st.integers(0, length - 1))] ^= data.draw(st.integers(1, 255))
    verdict = judged(frame, as_array(spoilt), length)
    if check is not None and spoilt[length - check.size :] != check.of(spoilt):
        assert verdict == WRONG_CHECKSUM
    elif spoilt[: len(head)] != head:
        assert verdict == NOT_THIS_FRAME
    else:
        assert verdict == GOOD


@pytest.mark.parametrize("name", CHECKSUMS)
def test_every_checksum_is_that_of_fastcrc(name):
    """All that fastcrc has, over frames of several lengths."""
    check = Checksum(name)
    chance = np.random.default_rng(5)
    for length in (check.size + 1, check.size + 9, 120):
        frame = FramePlan(length, [GroupPlan({"a": Field(0, "uint8")})], checksum=check).record()[0]
        for _ in range(5):
            sealed = chance.integers(0, 256, length, np.uint8)
            expected = bytearray(sealed)
            expected[length - check.size :] = check.of(expected)
            seal(frame, sealed)
            assert sealed.tobytes() == bytes(expected)
