"""Outer loops from the boldest down: what is not as predicted, or swings, is followed by a calmer one."""

from types import SimpleNamespace

import pytest

from micromanip.design.commission import closing
from micromanip.design.commission.closing import Bench, Options
from micromanip.errors import CheckFailed


@pytest.fixture
def proven(monkeypatch):
    """`prove_outer` with designs that hold from a bandwidth on; what it tried, and what it learned."""

    def play(predicted_to_Hz, rests_to_Hz, none_below_Hz=0.0):
        tried, learned = [], []

        def close_outer(bench, actuator, stage, options):
            hertz = options.bandwidth_Hz or 320.0
            if hertz < none_below_Hz:
                raise CheckFailed(f"axis {bench.axis}: nothing is stable at {hertz:g} Hz")
            tried.append(hertz)
            design = SimpleNamespace(bandwidth_Hz=hertz, outer=None)
            return stage, design, SimpleNamespace(as_predicted=hertz <= predicted_to_Hz, sentence="Ms 3"), lambda: ()

        def validate(*_):
            return SimpleNamespace(rest=SimpleNamespace(swings=tried[-1] > rests_to_Hz, told="2 um at 40 Hz"))

        monkeypatch.setattr(closing, "close_outer", close_outer)
        monkeypatch.setattr(closing, "validate", validate)
        monkeypatch.setattr(closing, "with_axis", lambda configuration, *_, **__: configuration)
        bench = Bench(None, None, "x", 1, lambda _: None, learned)
        return (lambda: closing.prove_outer(bench, None, None, Options(), None)), tried, learned

    return play


def test_the_boldest_that_holds_everything_is_taken(proven):
    prove, tried, learned = proven(1000.0, 1000.0)
    assert prove().design.bandwidth_Hz == 320.0
    assert tried == [320.0]
    assert not learned


def test_half_the_bandwidth_follows_what_is_not_as_predicted_or_swings(proven):
    prove, tried, learned = proven(200.0, 100.0)
    assert prove().design.bandwidth_Hz == 80.0
    assert tried == [320.0, 160.0, 80.0]
    assert "320 Hz it is not what was predicted" in learned[0]
    assert "160 Hz it swings at rest" in learned[1]


@pytest.mark.parametrize(("holds_to_Hz", "none_below_Hz"), [(10.0, 0.0), (1000.0, 1000.0), (100.0, 200.0)])
def test_where_none_holds_each_is_told_with_its_reason(proven, holds_to_Hz, none_below_Hz):
    prove, tried, _ = proven(1000.0, holds_to_Hz, none_below_Hz)
    with pytest.raises(CheckFailed) as said:
        prove()
    assert len(tried) <= 3
    for hertz in tried:
        assert f"at {hertz:g} Hz it swings at rest: 2 um at 40 Hz" in str(said.value)
    assert ("nothing is stable" in str(said.value)) is (none_below_Hz > 0.0)
