"""When decoupling goes on: beyond its uncertainty, where it pays, and where a second trial says so too."""

from dataclasses import replace

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.design.analyse.coupling import Coupling, Together
from micromanip.design.commission.coupled import Coupled, decoupled
from micromanip.design.commission.production import PathErrorSeen, Production
from micromanip.settings.load import load
from micromanip.settings.write import with_tuning

SIMULATED = CONFIG / "simulated.yaml"
TUNED = load(SIMULATED)
NAMES = tuple("xyz")
HERTZ = np.linspace(0.3, 300.0, 200)


def coupled(share=0.05, deviation=1e-4):
    matrix = np.eye(3) + share * (np.eye(3, k=1) + np.eye(3, k=-2))
    unsure = deviation * (1.0 - np.eye(3))
    over, around = (np.repeat(each[:, :, None], len(HERTZ), axis=2) for each in (matrix, unsure))
    found = Coupling(NAMES, HERTZ, over + 0j, around, matrix, unsure, np.eye(3), unsure)
    return Coupled(found, Together(0.2, 66.0, 0))


def tracked(configuration, rms=0.08):
    t_s = np.arange(8000) / 1000.0
    motion = np.stack([100.0 * np.sin(0.7 * t_s + i) + 30.0 * np.sin(2 * np.pi * 8.0 * t_s + i) for i in range(3)], 1)
    seen = {name: PathErrorSeen(100.0, rms, 0.3, t_s, motion[:, 0]) for name in NAMES}
    return Production(configuration, seen=seen, moved_um=motion)


def never(_):
    raise AssertionError("there is nothing to try again")


def test_what_is_sure_is_noted_and_what_is_not_is_not():
    noted = coupled().noted(TUNED)
    found = {name: axis.coupling.share for name, axis in noted.axes.items()}
    assert found == {"x": {"y": 0.05}, "y": {"z": 0.05}, "z": {"x": 0.05}}
    assert not any(axis.coupling.decouple for axis in noted.axes.values())
    unsure = coupled(deviation=0.02).noted(TUNED)
    assert [axis.coupling for axis in unsure.axes.values()] == [None] * 3


def test_it_is_switched_on_where_it_pays_and_the_second_trial_is_better():
    found = coupled()
    production, after = decoupled(
        tracked(found.noted(TUNED)), found, lambda production: tracked(production.configuration, 0.06)
    )
    assert after.decoupled == NAMES
    assert all(axis.coupling.decouple for axis in production.configuration.axes.values())
    assert production.seen["x"].rms == 0.06
    assert "x 0.080 to 0.060 um rms" in after.decided[0]
    assert after.cost["x"].ignored > 5.0 * after.cost["x"].decoupled
    text = with_tuning(SIMULATED.read_text(encoding="utf-8"), production.configuration.axes)
    assert text.count("decouple: true") == 3


@pytest.mark.parametrize(("rms", "share", "deviation"), [(2.0, 0.05, 1e-4), (0.08, 0.0005, 1e-4), (0.08, 0.05, 0.02)])
def test_it_stays_off_where_it_does_not_pay_is_small_or_not_sure(rms, share, deviation):
    found = coupled(share, deviation)
    before = tracked(found.noted(TUNED), rms)
    production, after = decoupled(before, found, never)
    assert production is before
    assert after.decoupled == ()
    assert "it is off" in after.decided[0]


def test_it_is_taken_back_where_the_second_trial_is_worse_or_ends():
    found = coupled()
    before = tracked(found.noted(TUNED))
    for again, says in (
        (lambda p: tracked(p.configuration, 0.09), "x 0.080 to 0.090 um rms"),
        (lambda p: replace(p, seen={}, problem="ended by fault X-202"), "ended by fault X-202"),
    ):
        production, after = decoupled(before, found, again)
        assert production is before
        assert after.decoupled == ()
        assert says in after.decided[0]


def test_a_coupling_that_is_not_found_again_leaves_the_file():
    file = with_tuning(SIMULATED.read_text(encoding="utf-8"), coupled().noted(TUNED).axes)
    assert file.count("coupling:") == 3
    assert "coupling:" not in with_tuning(file, TUNED.axes)
    assert with_tuning(file, coupled().noted(TUNED).axes) == file
