"""The device's time stamps in our own time."""

import itertools

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


def test_wrap_of_the_stamp():
    clock = DeviceClock(1e-6, 1 << 16)
    taken = [
        clock.taken_ns(stamp & 0xFFFF, received_ns)
        for stamp, received_ns, _ in messages(500, lambda _: 0, first_us=65_000)
    ]
    assert [b - a for a, b in itertools.pairwise(taken)] == [MS] * 499
    assert clock.steps == 0


def test_stamp_that_is_no_number():
    clock = DeviceClock(1.0, None)
    assert clock.taken_ns(float("nan"), 5) == 5
    assert clock.taken_ns(float("inf"), 6) == 6
    assert clock.taken_ns(1.0, 7 * S) == 7 * S
