"""Worst-case lengths of CAN frames, beside frames that are stuffed bit by bit."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus.can_bits import classic_bits, fd_bits, worst_case_s

MBIT = 1_000_000


def bits_of(value, count):
    return [(value >> place) & 1 for place in reversed(range(count))]


def stuffed(bits):
    """How many stuff bits the sender has inserted by each bit: after five equal ones, the inserted ones counted too."""
    inserted, counts, run, last = 0, [], 0, None
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            inserted, last, run = inserted + 1, 1 - bit, 1
        counts.append(inserted)
    return counts


def crc15(bits):
    register = 0
    for bit in bits:
        turn = bit ^ (register >> 14)
        register = ((register << 1) & 0x7FFF) ^ (0x4599 if turn else 0)
    return register


def exact_classic_bits(identifier, data, extended):
    if extended:
        header = [0, *bits_of(identifier >> 18, 11), 1, 1, *bits_of(identifier & 0x3FFFF, 18), 0, 0, 0]
    else:
        header = [0, *bits_of(identifier, 11), 0, 0, 0]
    bits = header + bits_of(len(data), 4) + [bit for byte in data for bit in bits_of(byte, 8)]
    bits += bits_of(crc15(bits), 15)
    return len(bits) + stuffed(bits)[-1] + 10 + 3


def exact_fd_bits(identifier, data):
    """Nominal and data bits up to the end of the data, which alone depend on the content, with 11 bits identifier."""
    header = [0, *bits_of(identifier, 11), 0, 0, 1, 0, 1]
    counts = stuffed(header + [0] + bits_of(0b1111, 4) + [bit for byte in data for bit in bits_of(byte, 8)])
    in_header = counts[len(header) - 1]
    return len(header) + in_header, len(counts) - len(header) + counts[-1] - in_header


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8), st.booleans())
def test_no_classic_frame_is_longer(identifier, data, extended):
    identifier = identifier if extended else identifier & 0x7FF
    assert exact_classic_bits(identifier, data, extended) <= classic_bits(len(data), extended)


def test_the_bound_is_not_sluggish():
    """Frames of content that stuffs much come within a few bits of it."""
    longest = max(exact_classic_bits(identifier, b"\x0f\x87\x87\x87", False) for identifier in range(0x800))
    assert classic_bits(4) - longest <= 3


@given(st.integers(0, 0x7FF), st.sampled_from((0, 8, 12, 24, 64)).flatmap(lambda n: st.binary(min_size=n, max_size=n)))
def test_no_fd_frame_is_longer(identifier, data):
    nominal, fast = exact_fd_bits(identifier, data)
    most_nominal, most_fast = fd_bits(len(data))
    tail_nominal, tail_fast = 12, 1 + (4 + 17 + 6 if len(data) <= 16 else 4 + 21 + 7)
    exact_s = (nominal + tail_nominal) / MBIT + (fast + tail_fast) / (8 * MBIT)
    assert exact_s <= most_nominal / MBIT + most_fast / (8 * MBIT) + 1e-12
    assert exact_s >= 0.6 * worst_case_s(len(data), MBIT, 8 * MBIT)


def test_cycles_of_known_buses():
    """Six 24-bit sensors and three 16-bit commands, packed in the ways that are usual."""
    a_frame_each = 6 * worst_case_s(3, MBIT) + 3 * worst_case_s(2, MBIT)
    pdos_and_sync = 4 * worst_case_s(6, MBIT) + worst_case_s(0, MBIT)
    fd = worst_case_s(24, MBIT, 5 * MBIT) + worst_case_s(8, MBIT, 5 * MBIT)
    assert a_frame_each == pytest.approx(735e-6, abs=1e-9)
    assert pdos_and_sync == pytest.approx(515e-6, abs=1e-9)
    assert fd == pytest.approx(145e-6, abs=0.5e-6)
    assert worst_case_s(24, MBIT, 8 * MBIT) == pytest.approx(68e-6, abs=0.5e-6)
    assert worst_case_s(8, MBIT, 8 * MBIT) == pytest.approx(47e-6, abs=0.5e-6)
