"""Models out of experiments and recordings: hysteresis, linear dynamics, the tracker's noise and path deviation."""
