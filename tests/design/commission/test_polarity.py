"""The first move tells a good axis from a bad one, and a bad one never gets its loop closed."""

import pytest

from micromanip.design.commission.polarity import judged
from micromanip.errors import CheckFailed

NOISE = {"x": 0.05, "y": 0.05, "z": 0.05}


def test_a_good_axis():
    found = judged("x", 20.0, {"x": 13.0, "y": 0.1, "z": -0.05}, NOISE)
    assert found.slope_um_per_V == pytest.approx(0.65)
    assert found.share("y", "x") == pytest.approx(0.1 / 13.0)


def test_an_axis_that_parks_at_the_top_moves_down():
    assert judged("x", -20.0, {"x": -13.0, "y": 0.0, "z": 0.0}, NOISE).slope_um_per_V > 0


@pytest.mark.parametrize(
    ("moved", "said"),
    [
        ({"x": -13.0, "y": 0.0, "z": 0.0}, "the wrong way, feedback would run away"),
        ({"x": 0.02, "y": 0.0, "z": 0.0}, "the actuator does not move, or the gauge does not see it"),
        ({"x": 0.02, "y": 13.0, "z": 0.0}, r"but that of axis y by \+13.00 um: the gauges or the outputs are swapped"),
        ({"x": 1300.0, "y": 0.0, "z": 0.0}, "is no piezo actuator"),
        ({"x": 13.0, "y": 0.0, "z": 6.0}, "look for a loose flexure or a gauge on the wrong stack"),
    ],
)
def test_a_bad_axis_is_told_apart(moved, said):
    with pytest.raises(CheckFailed, match=said) as refused:
        judged("x", 20.0, moved, NOISE)
    assert str(refused.value).endswith("Nothing was closed")
    assert str(refused.value).startswith(f"axis x: +20 V moved its strain gauge by {moved['x']:+.2f} um")
