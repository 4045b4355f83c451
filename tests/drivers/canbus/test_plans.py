"""Plans say of each frame what cantools says, bit by bit."""

import math
import random
from pathlib import Path

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st
from micromanip_drivers.canbus.bit_field import bit_field
from micromanip_drivers.canbus.plan import PackPlan, UnpackPlan

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
        assert any(not field.range[0] <= value <= field.range[1] for field, value in zip(fields, values, strict=True))
        return
    theirs = message.encode(dict(zip((signal.name for signal in message.signals), values, strict=True)), strict=False)
    assert data == theirs


def test_golden_frames():
    """Worked out by hand from the layouts, so that a mistake which cantools shares would show."""
    database = cantools.database.load_file(CONFIG / "manipulator.dbc")
    _, pack = plans(database.get_message_by_name("Voltages"))
    # (0 + 22) / 0.00275 = 8000 = 0x1f40, (150 + 22) / 0.00275 = 62545 = 0xf451, (-20 + 22) / 0.00275 = 727 = 0x02d7
    assert pack.data([0.0, 150.0, -20.0, 1, 0, 1, 7]) == bytes.fromhex("401f 51f4 d702 05 07")
    unpack, _ = plans(database.get_message_by_name("Sensors"))
    data = bytes.fromhex("40420f c0bdf0 ffffff" + "000080" + "ffff7f" + "010000" + "02 05 01 00 3412")
    expected = [100.0, -100.0, -0.0001, -838.8608, 838.8607, 0.0001, 2, 1, 0, 1, 0, 0, 0, 0, 0, 1, 0x1234]
    assert unpack.values(data) == pytest.approx(expected, rel=1e-12)
    classic = cantools.database.load_file(CONFIG / "classic.dbc")
    _, pack = plans(classic.get_message_by_name("Voltages"))
    order = [signal.name for signal in classic.get_message_by_name("Voltages").signals]
    values = {"voltage_x": 0.0, "voltage_y": 150.0, "voltage_z": -20.0, "heartbeat": 1, "Count": 7}
    assert pack.data([values.get(name, 0) for name in order]) == bytes.fromhex("1f40 f451 02d7 04 07")
