"""The device's counter: gaps, wraps, standstill, the past, and a device that begins anew."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus.device_counter import DeviceCounter


def followed(counts, bits=8):
    counter = DeviceCounter(bits)
    return counter, [counter.lost_before(count) for count in counts]


@given(st.integers(2, 16), st.integers(0, 2**16), st.lists(st.integers(1, 2), max_size=100))
def test_what_is_missing_is_counted_across_the_wrap(bits, first, steps):
    counts = [first % 2**bits]
    for step in steps:
        counts.append((counts[-1] + step) % 2**bits)
    counter, lost = followed(counts, bits)
    assert lost == [0, *(step - 1 for step in steps)]
    assert counter.counted("lost") == sum(step - 1 for step in steps)


def test_a_count_that_stands_still_is_not_fresh():
    counter, lost = followed([5, 5, 5, 6])
    assert lost == [0, None, None, 0]
    assert counter.counted("doubled") == 2


def test_a_frame_that_was_overtaken_is_not_fresh_and_changes_nothing():
    counter, lost = followed([250, 251, 253, 252, 254, 255, 0])
    assert lost == [0, 0, 1, None, 0, 0, 0]
    assert counter.counted("late") == 1


@pytest.mark.parametrize("bits", [8, 16])
def test_a_device_that_begins_anew_is_believed_after_a_few_frames(bits):
    last = 2**bits // 2 - 20
    counter, lost = followed([last, 0, 1, 2, 3, 4], bits)
    assert lost == [0, None, None, None, 0, 0]
    assert counter.counted("restarts") == 1
