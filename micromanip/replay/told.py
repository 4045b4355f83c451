"""What a recording tells of another tuning, and what it does not.

Not of rows around many missed cycles what it would have done in them.

While cycles are missed the voltage stays, and the stage goes where forces and open loop take it: what another voltage
would have done then follows from low frequencies of the actuator, of which a closed loop shows next to nothing. What
comes after is a way back over many micrometres, at the limits. So these rows, and those within the settling time, don't
count in any figure.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.laws.tooth import FOLLOWS
from micromanip.rt.outrun import AT_ONCE, REMEMBERED, UNSEEN

from .window import Window


def told_rows(window: Window, settle: int) -> NDArray[np.bool_]:
    """Which rows (n,) count: tracking for `settle` rows, and as many after the last gap that matters.

    That is one of more than `AT_ONCE` cycles, or what makes the calm gains act (``rt/outrun.py``), from its first on.
    """
    missed = np.maximum(window.rows["periods"].astype(np.int64) - 1, 0)
    many = np.cumsum(np.minimum(missed, AT_ONCE))
    lately = many - np.concatenate([np.zeros(min(REMEMBERED, len(many)), many.dtype), many[:-REMEMBERED]])
    disturbed = (missed > AT_ONCE) | (lately > UNSEEN)
    disturbed[: window.first] = False
    rows = np.arange(len(missed))
    last = np.maximum.accumulate(np.where(disturbed, rows, window.first))
    following = np.minimum.accumulate(np.where(disturbed, rows, len(rows) + REMEMBERED)[::-1])[::-1]
    return (rows > window.first) & (rows >= last + settle) & (rows <= following - REMEMBERED)


def untold_of_tooth(window: Window, parameters: NDArray[Any]) -> list[str]:
    """Sentences on the observers of the tooth of `parameters` (1,), where the piece does not begin with the arming.

    Whether one is given up (W-216) is decided in the air too, by seconds of samples before the piece.
    """
    found: list[str] = []
    if window.first > 0:
        return found
    given_up, anew = [], []
    for i, name in enumerate(window.axes):
        old, new = (each[0]["axis"][i]["outer"] for each in (window.parameters, parameters))
        if new["tooth"] == 0:
            continue
        goes_on = old["tooth"] == new["tooth"] and old["tooth_range"] == new["tooth_range"]
        if goes_on and window.state[0]["axis"][i]["estimator"]["given_up"] != FOLLOWS:
            given_up.append(name)
        elif old.tobytes() != new.tobytes():
            anew.append(name)
    if given_up:
        found.append(
            f"{', '.join(given_up)}: the tooth is not cancelled, as its observer had been given up before this piece "
            "(W-216); armed anew, the other tuning would follow it again"
        )
    if anew:
        found.append(
            f"{', '.join(anew)}: whether the tooth's observer lasts where nothing cuts (W-216) this piece does not "
            "tell; one that begins with the arming does"
        )
    return found
