"""The device's time stamps in our own time."""

import itertools
import random

import pytest
from micromanip_drivers.line.device_clock import DeviceClock

US, MS, S = 1000, 1_000_000, 1_000_000_000
BIRTH_NS = 12_345_678_901
WAY_NS = 200 * US


def messages(count, delay_ns, period_ns=MS, ppm=0.0, first_us=0):
    """(stamp in us, time of reception, time at which it was really stamped)."""
    for number in range(count):
        really_ns = BIRTH_NS + number * period_ns
        stamp_us = first_us + round((number * period_ns) * (1 + ppm * 1e-6) / US)
        yield stamp_us, really_ns + WAY_NS + delay_ns(number), really_ns


@pytest.mark.parametrize("ppm", [-50.0, 0.0, 50.0])
def test_jitter_of_the_way_is_taken_out_and_drift_is_followed(ppm):
    draw = random.Random(1)
    clock = DeviceClock(1e-6, None)
    late = []
    for stamp, received_ns, really_ns in messages(60_000, lambda _: draw.choice((0, 0, 50, 500, 2000)) * US, ppm=ppm):
        taken_ns = clock.taken_ns(stamp, received_ns)
        assert taken_ns <= received_ns
        late.append(taken_ns - really_ns - WAY_NS)
    assert max(map(abs, late[1000:])) < 20 * US
    assert clock.steps == 0


def test_wrap_of_the_stamp():
    clock = DeviceClock(1e-6, 1 << 16)
    taken = [
        clock.taken_ns(stamp & 0xFFFF, received_ns)
        for stamp, received_ns, _ in messages(500, lambda _: 0, first_us=65_000)
    ]
    assert [b - a for a, b in itertools.pairwise(taken)] == [MS] * 499
    assert clock.steps == 0


def test_clock_that_was_set_back_is_followed():
    clock = DeviceClock(1e-6, None)
    for stamp, received_ns, _ in messages(50, lambda _: 0, first_us=10_000_000):
        clock.taken_ns(stamp, received_ns)
    for number, (stamp, received_ns, really_ns) in enumerate(messages(20, lambda _: 0)):
        taken_ns = clock.taken_ns(stamp, received_ns + S)
        assert taken_ns <= received_ns + S
        if number > 5:
            assert taken_ns == really_ns + WAY_NS + S
    assert clock.steps == 1


def test_stamp_that_is_no_number():
    clock = DeviceClock(1.0, None)
    assert clock.taken_ns(float("nan"), 5) == 5
    assert clock.taken_ns(float("inf"), 6) == 6
    assert clock.taken_ns(1.0, 7 * S) == 7 * S
