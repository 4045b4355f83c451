"""Commissioning of a drawn plant; `make robustness` does fifty."""

import pytest
from micromanip.virtual.drawn_plants import LEAST_REACH_UM, SPREAD, drawn_cell

from micromanip.settings.check import prepare
from tools.robustness import CONFIG, commission_drawn


@pytest.fixture(scope="module")
def factory():
    return prepare(CONFIG)


def test_drawn_plants_are_seeded_and_reach_far_enough(factory):
    _, factors, reach = drawn_cell(factory, "x", 15)
    _, same, again = drawn_cell(factory, "x", 15)
    assert (factors, reach) == (same, again)
    assert reach >= LEAST_REACH_UM
    assert all(1.0 - SPREAD <= factor <= 1.0 + SPREAD for factor in factors.values())
    assert drawn_cell(factory, "x", 16)[1] != factors


@pytest.mark.long
@pytest.mark.parametrize("seed", range(1))
def test_drawn_plant(factory, seed):
    result = commission_drawn(factory, seed)
    assert result["refused"] is None
    assert result["stable"]
    assert result["good"], result
