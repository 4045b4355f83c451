"""What weakens a protection: every key that watches something has a direction, and the direction is right."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from campaigns.report import CONFIG
from micromanip.settings.change import is_weaker, said, values
from micromanip.settings.load import load

SIMULATED = CONFIG / "simulated.yaml"
WATCH, AXIS = ("faults", "axis"), ("axes", "x", "faults")
CASES = {
    "a larger limit": ((*WATCH, "following_error", "limit_um"), 5.0, 20.0),
    "no limit": ((*WATCH, "following_error", "limit_um"), 5.0, None),
    "a longer time": ((*AXIS, "saturation", "time_ms"), 500.0, 501.0),
    "a milder reaction": ((*AXIS, "strain", "reaction"), "ramp", "hold"),
    "only a warning": ((*AXIS, "amplifier", "reaction"), "off", "warn"),
    "a longer silence": (("faults", "link", "silent_ms"), 20.0, 300.0),
    "older samples": (("signals", "strain_x", "max_age_us"), 300.0, None),
    "a wider sensor": (("signals", "strain_x", "range_um"), [0, 100], [0, 101]),
    "a sensor that is elsewhere": (("signals", "strain_x", "range_um"), [0, 100], [50, 120]),
    "a sensor without a range of its own": (("signals", "strain_x", "range_um"), [0, 100], None),
    "a sensor with more than what is plausible": (("signals", "strain_x", "range_um"), None, [-1000, 1001]),
    "a faster process": ((*AXIS, "disagreement", "process_ms"), 20.0, 10.0),
    "a narrower band": ((*WATCH, "oscillation", "band_Hz"), [300, 1500], [300, 1000]),
    "another band": ((*AXIS, "oscillation", "band_Hz"), [300, 1500], [100, 1000]),
    "less is left while hot": ((*AXIS, "over_temperature", "derate_percent"), 50.0, 80.0),
}


@pytest.mark.parametrize(("path", "strong", "weak"), CASES.values(), ids=CASES)
def test_weaker_one_way_and_not_the_other(path, strong, weak):
    assert is_weaker(path, strong, weak)
    assert not is_weaker(path, strong, strong)
    if weak not in ([50, 120], [100, 1000]):  # neither lies within the other
        assert not is_weaker(path, weak, strong)


def test_every_key_that_watches_has_a_direction():
    """A new one under `faults` counts as weaker where it is larger, unless a rule says otherwise."""
    watching = {p: v for p, v in values(load(SIMULATED)).items() if p[0] == "faults" or p[2:3] == ("faults",)}
    assert len(watching) > 80
    for path, value in watching.items():
        assert said(path, "weaker") is not None
        assert not is_weaker(path, value, value)
        if path[-1] == "reaction":
            assert is_weaker(path, "off", "warn")


LIMIT = st.none() | st.floats(1e-3, 1e6)


@given(LIMIT, LIMIT, LIMIT)
def test_an_order(a, b, c):
    """Not both ways, and no way round in two steps that are each allowed."""
    path = ("faults", "axis", "following_error", "limit_um")
    assert not (is_weaker(path, a, b) and is_weaker(path, b, a))
    if is_weaker(path, a, c):
        assert is_weaker(path, a, b) or is_weaker(path, b, c)


PAIR = st.none() | st.tuples(st.floats(-100, 100), st.floats(-100, 100)).map(sorted)


@given(PAIR, PAIR, PAIR)
def test_an_order_of_ranges(a, b, c):
    path = ("signals", "strain_x", "range_um")
    if is_weaker(path, a, c):
        assert is_weaker(path, a, b) or is_weaker(path, b, c)
