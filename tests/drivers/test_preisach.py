"""The simulated stack's hysteresis: a Preisach operator, against its definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from micromanip_drivers.simulated.options import Plant
from micromanip_drivers.simulated.preisach import preisach_step, reset_memory
from micromanip_drivers.simulated.records import MEMORY, PREISACH, STACK

PLANT = Plant()


def operator(reversible=(0.0, 0.0, 0.0)):
    p = np.zeros(1, PREISACH)[0]
    p["c"], p["d"] = PLANT.preisach_c_um_per_V2, PLANT.preisach_d_per_V
    p["k1"], p["k2"] = PLANT.preisach_k1, PLANT.preisach_k2
    p["reversible"] = reversible
    s = np.zeros(1, MEMORY)[0]
    reset_memory(s)
    return p, s


P, _ = operator()


def along(v, p=P, s=None):
    if s is None:
        _, s = operator()
    return np.array([preisach_step(p, s, float(x)) for x in v])


def density(radius, middle):
    m = (middle - 60.0) / 75.0
    return float(P["c"] * np.exp(-P["d"] * radius) * (1.0 + P["k1"] * m + P["k2"] * m * m))


def relay_weights(low, high):
    """Density integrated over the unit cells of a relay grid, Gauss by Gauss: no Everett function in it."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    nodes, weights = (nodes + 1) / 2, weights / 2
    n = high - low
    cells = np.zeros((n, n))
    for i in range(n):  # switches up in low+i..low+i+1
        for j in range(i + 1):
            for x, wx in zip(nodes, weights, strict=True):
                for y, wy in zip(nodes, weights, strict=True):
                    up, down, area = low + i + x, low + j + y, 1.0
                    if j == i:
                        down, area = low + j + x * y, x  # the triangle down < up
                    # half: (radius, middle) instead of (up, down) as coordinates
                    cells[i, j] += 0.5 * wx * wy * area * density((up - down) / 2, (up + down) / 2)
    return cells


LOW, HIGH = -20, 10
RELAYS = relay_weights(LOW, HIGH)


def by_relays(v):
    """Every relay of the grid for itself."""
    up = np.arange(LOW, HIGH)[:, None] + 1  # on once the input is at its upper end
    down = np.arange(LOW, HIGH)[None, :]
    on = np.zeros_like(RELAYS, dtype=bool)
    out = []
    for x in v:
        on = (on | (x >= up)) & ~(x <= down)
        out.append(float((RELAYS * on).sum()))
    return np.array(out)


@given(st.lists(st.integers(LOW, HIGH), min_size=1, max_size=60))
def test_against_a_grid_of_relays(v):
    assert along(v) == pytest.approx(by_relays(v), rel=1e-6, abs=1e-9)


def test_full_memory_forgets_its_smallest_loops_only():
    """A shrinking oscillation of many more turns than fit: the outer loops are still there."""
    p, s = operator()
    turns = 3 * STACK
    v = [60.0 + (-1) ** k * 60.0 * (1.0 - k / turns) for k in range(turns)]
    along(v, p, s)
    assert s["merged"] > 0
    assert s["depth"] <= STACK
    outer = v[:2]
    assert along([outer[0], outer[1], outer[0]], p, s)[0] == pytest.approx(along(outer)[0], abs=1e-9)


def test_stroke_and_width_of_the_loop():
    """143 um over -20..140 V, a loop 16 um wide: 12 %."""
    p, s = operator(PLANT.reversible_um)
    up, down = np.linspace(-20.0, 140.0, 1601), np.linspace(140.0, -20.0, 1601)
    rising, falling = along(up, p, s), along(down, p, s)
    stroke = rising[-1] - rising[0]
    width = (falling[::-1] - rising).max()
    assert stroke == pytest.approx(143.0, abs=1.0)
    assert width == pytest.approx(16.0, abs=1.0)
    assert width / stroke == pytest.approx(0.12, abs=0.01)
    assert falling[-1] == pytest.approx(rising[0], abs=1e-9)
