"""Histogram of durations: contiguous bins of at most 1/32, percentiles within a bin."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from micromanip.host.statistics import percentile
from micromanip.rt.mailbox import BINS, SPLIT, bin_of, count, lower_edge

from .kernels import bins_course, edges_course

DURATIONS = st.integers(0, 2**62 - 1)
LAST = (62 - 5 + 1) * SPLIT - 1
"""The bin that ends at 2**62: longer durations than a century are not met."""


def edges(bins):
    out = np.zeros(len(bins), np.int64)
    edges_course(np.asarray(bins, dtype=np.int64), out)
    return out


def bins_of(values):
    out = np.zeros(len(values), np.int64)
    bins_course(np.asarray(values, dtype=np.int64), out)
    return out


def test_bins_are_contiguous_and_each_begins_at_its_edge():
    lower = edges(np.arange(LAST + 1))
    assert lower[0] == 0
    assert (np.diff(lower) > 0).all()
    assert (bins_of(lower) == np.arange(LAST + 1)).all()
    assert (bins_of(lower[1:] - 1) == np.arange(LAST)).all()


def test_relative_width_is_at_most_a_split():
    lower = edges(np.arange(LAST + 1)).astype(float)
    width = np.diff(lower)
    wide = width > 1.0
    assert wide.sum() > 1000
    assert (width[wide] / lower[:-1][wide] <= 1.0 / SPLIT).all()


@given(DURATIONS)
def test_a_duration_lies_in_its_bin(value):
    k = bin_of(value)
    assert lower_edge(k) <= value < lower_edge(k + 1)


@given(st.lists(st.integers(0, 10**10), min_size=1, max_size=200), st.floats(0.0, 1.0))
def test_percentile_is_within_a_bin_of_the_data(values, fraction):
    histogram = np.zeros(BINS, np.int64)
    for value in values:
        count(histogram, value)
    assert histogram.sum() == len(values)
    exact = int(np.percentile(values, 100.0 * fraction, method="inverted_cdf"))
    # ceil(fraction * n) and numpy's own rounding may differ by one place where the product is whole
    place = sorted(values).index(exact)
    candidates = {
        lower_edge(bin_of(v))
        for v in sorted(values)[max(0, place - 1) : place + len([v for v in values if v == exact]) + 1]
    }
    assert percentile(histogram, fraction) in candidates
