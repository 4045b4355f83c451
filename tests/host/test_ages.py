"""Percentiles of ages beside sorted samples."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from micromanip.host.signal_statistics import Ages


@given(
    st.lists(st.lists(st.integers(0, 1 << 39), max_size=40), min_size=1, max_size=4), st.sampled_from([0.5, 0.9, 0.999])
)
def test_percentile_is_that_of_the_sorted_ages_within_a_bin(parts, share):
    ages = Ages()
    for part in parts:
        ages.add(np.array(part, np.int64))
    every = sorted(age for part in parts for age in part)
    assert ages.maximum == (every[-1] if every else None)
    if not every:
        assert ages.percentile(share) is None
        return
    exact = every[max(0, int(np.ceil(share * len(every))) - 1)]
    found = ages.percentile(share)
    assert exact * (1 - 1 / 256) <= found <= exact
    if exact < 512:
        assert found == exact
