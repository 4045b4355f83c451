"""A thinned curve covers on paper what the whole one covers."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from micromanip.design.report.thinning import thinned

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(3000, 20_000))
def test_peaks_survive(seed, length):
    rng = np.random.default_rng(seed)
    x, y = np.linspace(0.0, 1.0, length), rng.normal(size=length)
    spikes = rng.choice(length, 2, replace=False)
    y[spikes] = 50.0, -50.0
    few_x, few_y = thinned(x, y, 400)
    assert set(x[spikes]) <= set(few_x)
    assert (few_y.max(), few_y.min()) == (50.0, -50.0)
    assert (few_x[0], few_x[-1]) == (x[0], x[-1])
    # in every piece of the axis, not only over all of it
    piece = np.minimum((x * 199).astype(int), 198)
    of_few = np.minimum((few_x * 199).astype(int), 198)
    for i in range(199):
        assert few_y[of_few == i].max() == y[piece == i].max()
        assert few_y[of_few == i].min() == y[piece == i].min()


def test_a_gap_stays_a_gap():
    x = np.arange(10_000.0)
    y = np.sin(x / 100)
    y[4000:6000] = np.nan
    few_x, few_y = thinned(x, y, 200)
    inside = (few_x >= 4000) & (few_x < 6000)
    assert inside.any()
    assert np.isnan(few_y[inside]).all()
    assert np.isfinite(few_y[~inside]).all()
