"""The self-starting CUSUM: mean and deviation are none of its business, its false alarms come as rarely as said."""

import numpy as np
import pytest

from micromanip.design.analyse.health.trend import Cusum, average_run_length, change_point, limit_for


def run(values, limit=4.0):
    cusum, sums = Cusum(limit), []
    for value in values:
        cusum.add(value)
        sums.append((cusum.upper, cusum.lower))
    return cusum, np.array(sums)


@pytest.mark.parametrize(("limit", "known"), [(3.0, 117.6), (4.0, 335.4), (5.0, 930.9)])
def test_run_lengths_are_those_of_the_tables(limit, known):
    """One-sided, allowance .5: Hawkins and Olwell (1998) by a Markov chain."""
    assert average_run_length(limit) == pytest.approx(known, rel=0.02)
    assert limit_for(known) == pytest.approx(limit, rel=0.01)


def test_without_a_shift_it_alarms_as_rarely_as_said():
    """Also from the third value on, without any time of learning."""
    wanted, rng, lengths = 20.0, np.random.default_rng(3), []
    limit = limit_for(2 * wanted)
    for _ in range(150):
        cusum, length = Cusum(limit), 0
        while cusum.crossed is None and length < 200:
            cusum.add(rng.normal(5.0, 0.1))
            length += 1
        lengths.append(length)
    assert np.mean(lengths) == pytest.approx(wanted, rel=0.25)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_shift_is_found_and_its_beginning_named(sign):
    values = np.random.default_rng(1).normal(0.0, 1.0, 40)
    values[25:] += sign * 4.0
    cusum, _ = run(values, limit_for(2000.0))
    assert 25 <= cusum.crossed <= 28
    assert abs(change_point(values[: cusum.crossed + 1]) - 25) <= 1
