"""Error budget of an axis: the variance of its path error by cause, a causal bound, and what another sensor would give."""
