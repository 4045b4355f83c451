"""By how much joints' frequencies move until they are found, where nobody says: a fit's default.

Apart from the fit: the help of a command tells it, and does not wait for what computes.
"""

MOVES_PERCENT = 2.0
"""Narrower filters leave less of a frequency that stays, wider ones of one that jumps or sweeps."""
