"""In a hold for want of a reference each axis goes back to its working point in a time of its own."""

import numpy as np

from micromanip.rt.cell import held_share
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE
from micromanip.rt.states import FOLLOWING_ERROR, HOLDING, REFERENCE_LOST


def scales(fault):
    """What is left of the way after 20 cycles, on an axis with 40 cycles and on one with 400."""
    p, s = np.zeros(1, CELL_PARAMETERS)[0], np.zeros(1, CELL_STATE)[0]
    p["axes"] = 2
    p["axis"]["watch"]["decay_cycles"][:2] = 40, 400
    s["state"], s["fault"], s["entered_cycle"], s["cycle"] = HOLDING, fault, 100, 120
    return [held_share(p, s, i) for i in range(2)]


def test_each_axis_decays_in_its_own_time():
    quick, slow = scales(REFERENCE_LOST)
    assert abs(quick - 0.5) < 1e-9
    assert 0.98 < slow < 1.0


def test_another_hold_stays_where_it_is():
    assert scales(FOLLOWING_ERROR) == [1.0, 1.0]
