"""What a slow record of the whole stroke shows of its branches."""

import itertools

import numpy as np
import pytest

from micromanip.design.commission.quality import steepest_branch

RANGE_UM = (5.0, 80.0)


def triangle(*ends):
    return np.concatenate([np.linspace(a, b, 4000, endpoint=False) for a, b in itertools.pairwise(ends)])


def test_the_steepest_piece_of_a_branch_within_the_set_points_is_found():
    """Steep where it comes from above 60 V; steeper still below 5 um, where no set-point is."""
    v = triangle(0.0, 100.0, 0.0, 80.0, 10.0)
    rising = np.gradient(v) > 0.0
    y = np.where(rising, 0.8 * v, 0.8 * v + 20.0 * np.exp(-(((v - 60.0) / 10.0) ** 2)))
    y = np.where(v < 4.0, 3.2 + 4.0 * (v - 4.0), y) + np.random.default_rng(1).normal(0.0, 0.05, len(v))
    bend = np.linspace(40.0, 80.0, 4000)
    most = np.max(0.8 - 20.0 * 2.0 * (bend - 60.0) / 100.0 * np.exp(-(((bend - 60.0) / 10.0) ** 2)))
    assert steepest_branch(v, y, RANGE_UM) == pytest.approx(most, rel=0.06)


def test_a_record_without_a_way_says_nothing():
    assert steepest_branch(np.full(100, 3.0), np.zeros(100), RANGE_UM) == 0.0
