"""Numbers to registers and back: by hand, beside the library, and beside the simulated device's own packing."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from micromanip_drivers.modbus.codec import Field, ReadPlan, WritePlan
from micromanip_drivers.modbus.options import REGISTERS, Input, Output, Register, code_range
from pymodbus.client.mixin import ModbusClientMixin

from micromanip.bus.errors import OutputRefused

NUMBERS = [kind for kind in REGISTERS if kind not in ("coil", "bits")]
INTEGERS = [kind for kind in NUMBERS if "int" in kind]
ORDERS = ("big", "little")
orders = st.sampled_from(ORDERS)


def field(kind, place=0, byte_order="big", word_order="big", cls=Input, name="v", **keys):
    also = {"cyclic_safe": True} if cls is Output else {}
    return Field(name, cls(address=0, type=kind, **also, **keys), place, byte_order, word_order)


def code_of(draw, kind):
    if kind in INTEGERS:
        low, high = code_range(Register(address=0, type=kind))
        return draw(st.integers(low, high))
    return draw(st.floats(width=32 if kind == "float32" else 64, allow_nan=False, allow_infinity=False))


@pytest.mark.parametrize(
    ("kind", "byte_order", "word_order", "wire", "value"),
    [
        ("int16", "big", "big", "fb2e", -1234),
        ("int16", "little", "big", "2efb", -1234),
        ("uint16", "big", "big", "fb2e", 64302),
        ("int32", "big", "big", "0001e240", 123456),
        ("int32", "big", "little", "e2400001", 123456),
        ("int32", "little", "big", "010040e2", 123456),
        ("int32", "little", "little", "40e20100", 123456),
        ("uint32", "big", "little", "fffeffff", 4294967294),
        ("float32", "big", "big", "c0490000", -3.140625),
        ("float32", "big", "little", "0000c049", -3.140625),
        ("float32", "little", "big", "49c00000", -3.140625),
        ("float32", "little", "little", "000049c0", -3.140625),
        ("float64", "big", "big", "c009200000000000", -3.140625),
        ("float64", "big", "little", "000000002000c009", -3.140625),
        ("int64", "little", "little", "0200000000000000", 2),
    ],
)
def test_numbers_worked_out_by_hand(kind, byte_order, word_order, wire, value):
    one = field(kind, 0, byte_order, word_order)
    assert ReadPlan([one]).values(bytes.fromhex(wire)) == [value]
    written = field(kind, 0, byte_order, word_order, Output)
    assert WritePlan([written], REGISTERS[kind]).data({"v": value}).hex() == wire


@given(st.data())
def test_as_the_library_reads_them(data):
    kind, word_order = data.draw(st.sampled_from(NUMBERS)), data.draw(orders)
    code = code_of(data.draw, kind)
    kinds = ModbusClientMixin.DATATYPE
    registers = ModbusClientMixin.convert_to_registers(code, getattr(kinds, kind.upper()), word_order=word_order)
    wire = struct.pack(f">{len(registers)}H", *registers)
    assert ReadPlan([field(kind, 0, "big", word_order)]).codes(wire) == [code]


@pytest.mark.parametrize("kind", NUMBERS)
def test_ends_of_the_range_are_sent_and_what_is_beyond_is_refused(kind):
    low, high = code_range(Register(address=0, type=kind))
    plan = WritePlan([field(kind, cls=Output)], REGISTERS[kind])
    for end in (low, high):
        if abs(end) < 2**53:
            assert ReadPlan([field(kind)]).codes(plan.data({"v": end})) == [end]
        if math.isfinite(end):
            with pytest.raises(OutputRefused):
                plan.data({"v": end * 1.001 + math.copysign(1, end) if end else -1.0})


def test_a_range_of_its_own_is_kept():
    plan = WritePlan([field("int16", cls=Output, scale=0.01, range=(-20.0, 150.0))], 1)
    plan.data({"v": 150.0})
    with pytest.raises(OutputRefused, match="it may be -20 to 150"):
        plan.data({"v": 150.01})
