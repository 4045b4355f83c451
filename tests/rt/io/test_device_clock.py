"""The device's time in ours: right for any offset and drift of its clock, never after the datagram came."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.rt.io.clock_lock import DEVICE_CLOCK, taken_ns

PERIOD_NS = 100_000


def clock(unit_ns, bits):
    found = np.zeros(1, DEVICE_CLOCK)
    found["unit_ns"], found["bits"] = unit_ns, bits
    return found[0]


def stamp_of(device_ns, unit_ns, bits):
    return np.uint64(int(device_ns // unit_ns) % 2**bits)


@given(
    st.sampled_from([(1000.0, 32), (1000.0, 16), (1.0, 32), (100.0, 24), (1.0, 62)]),
    st.integers(0, 2**40),
    st.floats(-80e-6, 80e-6),
    st.lists(st.integers(5_000, 90_000), min_size=60, max_size=120),
)
def test_the_way_and_its_variation_are_taken_out(kind, offset_ns, drift, ways_ns):
    unit_ns, bits = kind
    c, shortest = clock(unit_ns, bits), min(ways_ns)
    ways_ns = [shortest, *ways_ns]
    for k, way_ns in enumerate(ways_ns):
        sampled_ns = 10**12 + k * PERIOD_NS
        stamp = stamp_of(offset_ns + k * PERIOD_NS * (1 + drift), unit_ns, bits)
        found_ns = taken_ns(c, stamp, sampled_ns + way_ns)
        assert found_ns <= sampled_ns + way_ns
        followed_ns = 100e-6 * (k * PERIOD_NS + way_ns)
        assert found_ns - (sampled_ns + shortest) == pytest.approx(0, abs=2 * followed_ns + 2 * unit_ns + 2)
    assert c["steps"] == 0


@pytest.mark.parametrize("jump_ns", [-3_000_000_000, 3_000_000_000])
def test_a_clock_that_was_set_is_taken_as_it_is(jump_ns):
    c, begin_ns = clock(1000.0, 32), 10**12
    for k in range(40):
        device_ns = 5_000_000_000 + k * PERIOD_NS + (jump_ns if k >= 20 else 0)
        found_ns = taken_ns(c, stamp_of(device_ns, 1000.0, 32), begin_ns + k * PERIOD_NS)
    assert c["steps"] == 1
    assert found_ns == pytest.approx(begin_ns + 39 * PERIOD_NS, abs=2000)
