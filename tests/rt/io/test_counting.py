"""What a counter tells: each gap once, whatever its width and wherever it wraps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.rt.io.counting import COUNTED, OLD, RESTARTED, missing_before

WIDTHS = st.sampled_from([2**8, 2**16, 2**32])


def counter(counts):
    found = np.zeros(1, COUNTED)
    found["counts"] = counts
    return found[0]


@given(WIDTHS, st.integers(0, 2**32 - 1), st.lists(st.integers(0, 100), min_size=1, max_size=40))
def test_each_gap_is_counted_once(counts, begin, gaps):
    c, count = counter(counts), begin % counts
    assert missing_before(c, count) == 0
    for gap in gaps:
        count = (count + gap + 1) % counts
        assert missing_before(c, count) == gap
    assert c["lost"] == sum(gaps)
    assert c["doubled"] == c["late"] == c["restarts"] == 0


@given(WIDTHS, st.integers(0, 2**32 - 1), st.integers(1, 100))
def test_what_came_twice_or_was_overtaken_is_not_fresh(counts, begin, back):
    c = counter(counts)
    missing_before(c, begin % counts)
    assert missing_before(c, begin % counts) == OLD
    assert missing_before(c, (begin - back) % counts) == OLD
    assert missing_before(c, (begin + 1) % counts) == 0
    assert (c["doubled"], c["late"], c["lost"]) == (1, 1, 0)


@pytest.mark.parametrize("stands_at", [100, 30_000])
def test_a_device_that_began_anew_is_noticed(stands_at):
    c = counter(2**16)
    missing_before(c, stands_at)
    found = [missing_before(c, count) for count in range(6)]
    assert found == [OLD, OLD, OLD, RESTARTED, 0, 0]
    assert c["restarts"] == 1


def test_a_counter_that_stands_still_is_never_fresh():
    c = counter(2**16)
    missing_before(c, 7)
    assert [missing_before(c, 7) for _ in range(20)] == [OLD] * 20
