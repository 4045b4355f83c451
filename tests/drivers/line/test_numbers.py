"""Numbers in frames: golden bytes worked out by hand, and the struct module as the oracle for the rest."""

import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from micromanip_drivers.line.frame_options import InputField, Number, OutputField, WholeNumber
from micromanip_drivers.line.frame_parts import InputNumber, OutputNumber, PacketCounter

from micromanip.bus.errors import OutputRefused
from micromanip.bus.number_options import SIZES
from micromanip.driver.wire import NumberCodec

GOLDEN = [
    ("int8", "little", "80", -128),
    ("uint8", "big", "ff", 255),
    ("int16", "little", "fe ff", -2),
    ("int16", "big", "80 01", -32767),
    ("uint16", "big", "12 34", 0x1234),
    ("uint16", "little", "12 34", 0x3412),
    ("int24", "little", "01 00 80", -8388607),
    ("int24", "big", "ff ff fe", -2),
    ("uint24", "big", "01 02 03", 0x010203),
    ("uint24", "little", "01 02 03", 0x030201),
    ("int32", "big", "ff ff ff 85", -123),
    ("uint32", "little", "78 56 34 12", 0x12345678),
    ("int64", "big", "ff ff ff ff ff ff ff f6", -10),
    ("uint64", "little", "01 00 00 00 00 00 00 80", 0x8000000000000001),
    ("float32", "little", "00 00 60 c0", -3.5),
    ("float32", "big", "40 49 0f db", 3.1415927410125732),
    ("float64", "big", "bf f8 00 00 00 00 00 00", -1.5),
]


def codec(kind, order, at=0):
    return NumberCodec(Number(at=at, type=kind, byte_order=order))


@pytest.mark.parametrize(("kind", "order", "wire", "number"), GOLDEN)
def test_golden_numbers(kind, order, wire, number):
    data = bytes.fromhex(wire)
    one = codec(kind, order, at=2)
    assert one.read(b"\x55\x55" + data + b"\x55") == number
    assert one.read(b"\x55\x55\x55" + data, 1) == number
    written = bytearray(2 + len(data))
    one.write(written, number)
    assert written[2:] == data


@example(5.6e306, "int16", 0.03125, 0.0)  # infinite in steps of the scale
@given(st.floats(), st.sampled_from(sorted(SIZES)), st.floats(1e-6, 1e6), st.floats(-1e3, 1e3))
def test_every_value_is_sent_as_it_is_or_refused(value, kind, scale, offset):
    options = OutputField(at=0, type=kind, byte_order="little", scale=scale, offset=offset, safe=offset)
    wire = bytearray(8)
    try:
        OutputNumber("voltage", options).put(wire, value)
    except OutputRefused:
        assert wire == bytes(8)
        return
    back = InputNumber(InputField(at=0, type=kind, byte_order="little", scale=scale, offset=offset)).value(wire)
    coarse = 0.5 * scale if "int" in kind else 2e-7 * abs(value - offset) + 1e-37 * scale
    assert abs(back - value) <= coarse * (1 + 1e-9) + 1e-12 * (abs(value) + abs(offset))


def test_range_is_kept_also_with_a_negative_scale():
    options = OutputField(at=0, type="int16", byte_order="big", scale=-0.01, offset=10.0, range=(-20, 150))
    one, wire = OutputNumber("voltage", options), bytearray(2)
    for bad in (-20.01, 150.01):
        with pytest.raises(OutputRefused, match="-20 to 150"):
            one.put(wire, bad)
    one.put(wire, 150.0)
    assert struct.unpack(">h", wire) == (-14000,)


def counted(counter, *counts, samples=1):
    return [counter.samples_before(bytes((count & 0xFF,)), samples) for count in counts]


def byte_counter(by_sample=False):
    return PacketCounter(WholeNumber(at=0, type="uint8"), by_sample)


def test_samples_in_packets():
    """The count is that of the first of four samples; packets may have other numbers of them too."""
    counter = byte_counter(by_sample=True)
    assert counted(counter, 248, 252, 0, 4, samples=4) == [0, 0, 0, 0]
    assert counted(counter, 16, samples=1) == [8]
    assert counted(counter, 17, 21, samples=4) == [0, 0]
    assert counted(counter, 21, samples=4) == [None]
    assert counted(counter, 100, 200, samples=4) == [75, 96]
    assert counted(counter, 150, 154, 158, 162, samples=4) == [None, None, None, 0]  # anew
    assert counter.restarts == 1
