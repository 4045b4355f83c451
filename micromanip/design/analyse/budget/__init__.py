"""Error budget of an axis: variance of its path error by cause, a causal bound, and what another sensor would give."""
