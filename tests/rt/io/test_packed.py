"""Entries of PDOs of any widths, packed by bits: each is found again, and nothing that lies beside it is touched."""

from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba import types

from micromanip.bus.ethercat.process_data import bytes_of, packed_numbers
from micromanip.bus.frame_plan import FramePlan, GroupPlan
from micromanip.bus.number_options import BITS, number_range
from micromanip.rt.io.frames import FRAME, code_of, put_value, value_of
from micromanip.rt.jit import Compiler
from micromanip.rt.signatures import array_of

compiled = Compiler(__file__)

KINDS = [kind for kind in BITS if not kind.startswith("float")]
ENTRIES = st.lists(st.sampled_from(KINDS), min_size=1, max_size=20)


@compiled.entry(types.void(array_of(FRAME), types.uint8[::1], types.uint64[::1], types.float64[::1]))
def read_all(frames, data, codes, values):
    """Codes and values of all numbers, compiled."""
    frame = frames[0]
    for i in range(frame["numbers"]):
        codes[i], values[i] = code_of(frame["number"][i], data), value_of(frame, frame["number"][i], data)


@compiled.entry(types.void(array_of(FRAME), types.uint8[::1], types.float64[::1]))
def put_all(frames, data, values):
    """All values in their places, compiled."""
    frame = frames[0]
    for i in range(frame["numbers"]):
        put_value(frame, frame["number"][i], data, values[i])


def plan(kinds, at):
    """The table of such entries, PDO by PDO of two each, behind `at` other bytes; and their whole length."""
    fields = {f"f{i}": SimpleNamespace(type=k, bits=BITS[k], scale=1.0, offset=0.0) for i, k in enumerate(kinds)}
    names = list(fields)
    pdos = {
        names[i]: SimpleNamespace(fields={name: fields[name] for name in names[i : i + 2]})
        for i in range(0, len(names), 2)
    }
    numbers = {name: each for _, found in packed_numbers(pdos, at) for name, each in found.items()}
    length = at + bytes_of(BITS[kind] for kind in kinds) + 1
    return FramePlan(length, [GroupPlan(numbers)]).record(), length


def place_of(kinds, at, i):
    """First bit of entry `i` and its mask, of the frame as one number whose first byte is the lowest."""
    first = 8 * at + sum(BITS[kind] for kind in kinds[:i])
    return first, ((1 << BITS[kinds[i]]) - 1) << first


def signed(kind, code):
    return code - (1 << BITS[kind]) if kind.startswith("i") and code >> (BITS[kind] - 1) else code


@given(ENTRIES, st.integers(0, 3), st.data())
def test_any_packing_is_read_bit_for_bit_as_python_does(kinds, at, data):
    table, length = plan(kinds, at)
    frame = table[0]
    raw = data.draw(st.binary(min_size=length, max_size=length))
    whole, came = int.from_bytes(raw, "little"), np.frombuffer(raw, np.uint8).copy()
    codes, values = np.zeros(len(kinds), np.uint64), np.zeros(len(kinds))
    read_all(table, came, codes, values)
    for i, kind in enumerate(kinds):
        first, mask = place_of(kinds, at, i)
        code = (whole & mask) >> first
        assert int(codes[i]) == int(code_of(frame["number"][i], came)) == code
        assert values[i] == float(signed(kind, code))


@given(ENTRIES, st.integers(0, 3), st.data())
def test_what_is_written_comes_back_and_its_neighbours_stay(kinds, at, data):
    table, length = plan(kinds, at)
    frame = table[0]
    before = data.draw(st.binary(min_size=length, max_size=length))
    i = data.draw(st.integers(0, len(kinds) - 1))
    low, high = (int(end) for end in number_range(kinds[i]))
    value = float(data.draw(st.integers(low, high)))
    written = np.frombuffer(before, np.uint8).copy()
    assert put_value(frame, frame["number"][i], written, value)
    assert value_of(frame, frame["number"][i], written) == value
    _, mask = place_of(kinds, at, i)
    changed = int.from_bytes(before, "little") ^ int.from_bytes(written.tobytes(), "little")
    assert changed & ~mask == 0
    again = np.frombuffer(before, np.uint8).copy()
    values = np.full(len(kinds), np.nan)  # which is not sent
    values[i] = value
    put_all(table, again, values)
    assert again.tobytes() == written.tobytes()


def test_what_a_bit_can_not_hold_is_not_written():
    frame = plan(["bool", "bit3"], 0)[0][0]
    written = np.array([0b1010, 0], np.uint8)
    for value in (2.0, -1.0, np.nan, np.inf):
        assert not put_value(frame, frame["number"][0], written, value)
    assert written[0] == 0b1010
