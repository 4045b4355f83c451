"""Reading a signal: fresh or held, stale, bad, never seen."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.rt.laws.sensor import SENSOR_STATE, is_silent, read_signal
from micromanip.rt.records import SIGNAL

from .builders import record

MAX_AGE_NS = 300_000


ANYTHING = np.array([-np.inf, np.inf])


def read(signal, s, now_ns, max_age_ns=MAX_AGE_NS, range_um=ANYTHING, rate_um_per_ns=math.inf):
    return bool(read_signal(signal, s, now_ns, max_age_ns, range_um, rate_um_per_ns))


def seen(sequence=1, value=5.0, time_ns=1_000_000):
    """Sensor state after one good sample."""
    s = record(SENSOR_STATE)
    assert read(record(SIGNAL, value=value, time_ns=time_ns, sequence=sequence), s, time_ns)
    return s


def test_staleness_counts_cycles_until_a_fresh_sample():
    s, held = seen(), record(SIGNAL, value=5.0, time_ns=1_000_000, sequence=1)
    counts = []
    for cycle in range(1, 7):
        read(held, s, 1_000_000 + cycle * 100_000)
        counts.append(int(s["bad"]))
    assert counts == [0, 0, 0, 1, 2, 3]  # 300 us are still good
    assert read(record(SIGNAL, value=7.0, time_ns=1_700_000, sequence=2), s, 1_700_000)
    assert (s["value"], s["bad"], s["fresh"]) == (7.0, 0, 1)


def test_a_fresh_sample_may_itself_be_too_old():
    """It counts as unusable however often it comes."""
    s = record(SENSOR_STATE)
    for sequence in (1, 2, 3):
        read(record(SIGNAL, value=1.0, time_ns=1_000, sequence=sequence), s, 1_000_000)
    assert s["bad"] == 3
    assert is_silent(s, MAX_AGE_NS), "the bus, a clock or the device is late, the sensor is not to blame"


@pytest.mark.parametrize(
    "fields", [{"status": 1}, {"status": -7}, {"value": math.nan}, {"value": math.inf}, {"value": -math.inf}]
)
def test_a_bad_sample_keeps_the_last_good_value(fields):
    s = seen()
    bad = record(SIGNAL, **{"value": 9.0, "time_ns": 1_100_000, "sequence": 2, **fields})
    assert not read(bad, s, 1_100_000)
    assert (s["value"], s["time_ns"], s["age_ns"], s["fresh"], s["bad"]) == (5.0, 1_000_000, 100_000, 0, 1)
    # until the next sample of a slow sensor it stays the last word
    read(bad, s, 1_150_000)
    assert s["bad"] == 1
    read(record(SIGNAL, value=6.0, time_ns=1_200_000, sequence=3), s, 1_200_000)
    assert (s["value"], s["bad"], s["fresh"]) == (6.0, 0, 1)


@pytest.mark.parametrize(
    ("value", "good"), [(-10.0, True), (120.0, True), (-10.001, False), (120.001, False), (1e308, False)]
)
def test_a_sample_outside_the_plausible_range_is_bad(value, good):
    s = seen()
    sample = record(SIGNAL, value=value, time_ns=1_100_000, sequence=2)
    assert read(sample, s, 1_100_000, range_um=np.array([-10.0, 120.0])) == good
    assert (s["value"], s["bad"]) == ((value, 0) if good else (5.0, 1))


def test_bad_samples_in_a_row_add_up():
    s = seen()
    for k in range(3):
        read(record(SIGNAL, value=math.nan, time_ns=0, sequence=2 + k), s, 1_100_000 + k)
    assert s["bad"] == 3


def test_a_driver_that_counts_anew_loses_nothing():
    """A bus that was reconnected may start its sequence over: fresh, and the counter does not run backwards."""
    s = seen(sequence=1000)
    assert read(record(SIGNAL, value=8.0, time_ns=1_100_000, sequence=1), s, 1_100_000)
    assert s["value"] == 8.0
    assert s["unseen"] >= 0


@pytest.mark.parametrize("max_age_ns", [MAX_AGE_NS, 2**61])
def test_a_sensor_that_never_spoke_is_not_good(max_age_ns):
    """Also where its age is not limited, or the clock has only just begun."""
    s = record(SENSOR_STATE)
    assert not read(record(SIGNAL), s, 100_000, max_age_ns)
    assert s["bad"] > 0


EVENT = st.tuples(
    st.integers(0, 3),  # samples since the cycle before
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0, 0, 0, 1]),
    st.integers(0, 400_000),  # age on arrival
)


@given(st.lists(EVENT, max_size=40))
def test_any_course_of_samples(events):
    s, now, sequence, last_good, unseen = seen(sequence=5), 1_000_000, 5, (5.0, 1_000_000), 0
    before = int(s["samples"] + s["refused"])
    for new, value, status, age in events:
        now += 100_000
        sequence += new
        good = new > 0 and status == 0 and math.isfinite(value)
        fresh = read(record(SIGNAL, value=value, time_ns=now - age, sequence=sequence, status=status), s, now)
        if good:
            last_good = (value, now - age)
        unseen += max(0, new - 1)
        assert fresh == good
        assert (s["value"], s["time_ns"]) == last_good
        assert s["age_ns"] == now - last_good[1]
        assert s["unseen"] == unseen
        assert s["samples"] + s["refused"] - before + s["unseen"] == sequence - 5, "each is one of these"
        assert (s["bad"] == 0) or not good or s["age_ns"] > MAX_AGE_NS
        assert math.isfinite(s["value"])


def test_a_sample_taken_after_the_deadline_counts_as_of_now():
    """A worker receives while the loop waits; and a device whose clock runs ahead still grows old."""
    s = seen()
    assert read(record(SIGNAL, value=6.0, time_ns=1_160_000, sequence=2), s, 1_100_000)
    assert (s["age_ns"], s["time_ns"]) == (0, 1_100_000)
    ahead = record(SIGNAL, value=7.0, time_ns=10**12, sequence=3)
    assert read(ahead, s, 1_200_000)
    read(ahead, s, 1_200_000 + MAX_AGE_NS + 100_000)
    assert s["bad"] == 1


def test_samples_that_arrive_together_may_differ_by_what_passed_between_them():
    """A bus delivers two samples, taken 500 us apart, in one cycle and the next."""
    rate = 100.0 * 1e-6  # um/ns
    s = seen(value=5.0, time_ns=1_000_000)
    assert read(record(SIGNAL, value=45.0, time_ns=1_500_000, sequence=2), s, 2_000_000, rate_um_per_ns=rate)
    assert read(record(SIGNAL, value=85.0, time_ns=2_000_000, sequence=3), s, 2_100_000, rate_um_per_ns=rate)
    assert not read(record(SIGNAL, value=150.0, time_ns=2_500_000, sequence=4), s, 2_500_000, rate_um_per_ns=rate)
