"""Plans say of each frame what cantools says, bit by bit."""

import math
import random
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from micromanip_drivers.canbus.plan import PackPlan, UnpackPlan, bit_field

from micromanip.bus.errors import OutputRefused

from .layouts import messages

CONFIG = Path(__file__).parents[3] / "config/can"


def plans(message):
    fields = [bit_field(signal, message.length) for signal in message.signals]
    return UnpackPlan(fields), PackPlan(fields, message.length)


def same(ours, theirs):
    return ours == theirs or (math.isnan(ours) and math.isnan(theirs))


def decoded(message, data):
    values = message.decode(data, decode_choices=False)
    return [values[signal.name] for signal in message.signals]


@given(messages(), st.integers(0, 2**32))
def test_any_frame_is_unpacked_as_cantools_does(message, seed):
    data = random.Random(seed).randbytes(message.length)
    unpack, _ = plans(message)
    assert all(same(*pair) for pair in zip(unpack.values(data), decoded(message, data), strict=True))


@given(messages(), st.integers(0, 2**32))
def test_any_values_are_packed_as_cantools_does(message, seed):
    values = decoded(message, random.Random(seed).randbytes(message.length))
    # a double holds 53 bits: codes beyond come out rounded, in cantools (whole numbers) not
    values = [value if math.isfinite(value) and abs(value) < 2**40 else 0.0 for value in values]
    _, pack = plans(message)
    try:
        data = pack.data(values)
    except OutputRefused:
        fields = [bit_field(signal, message.length) for signal in message.signals]
        codes = [(value - field.offset) / field.scale for field, value in zip(fields, values, strict=True)]
        assert any(not field.low <= code <= field.high for field, code in zip(fields, codes, strict=True))
        return
    theirs = message.encode(dict(zip((signal.name for signal in message.signals), values, strict=True)), strict=False)
    assert data == theirs
