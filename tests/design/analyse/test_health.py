"""What is said of an axis beside its model: figures of a flexure, and what is no longer as it was commissioned."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.signal import cont2discrete

from micromanip.control.injection import injection
from micromanip.control.system import System
from micromanip.design.analyse.health import Check, PlantFigures, commissioned, plant_figures, problems_of
from micromanip.design.identify.response import Measured
from micromanip.settings.schema.accept import Accept

HERTZ = injection(0.3, 3000.0, 10_000.0, seed=1).frequency_Hz
NEAR = PlantFigures(5.0, 67.0, 0.02)


def measured(response, noise=0.0, seed=1):
    rng = np.random.default_rng(seed)
    seen = response * (1.0 + noise * (rng.normal(size=len(HERTZ)) + 1j * rng.normal(size=len(HERTZ))))
    deviation = np.full(len(HERTZ), noise) * np.abs(response)
    return Measured(HERTZ, seen, seen[None], deviation, deviation)


def flexure(gain, mode_Hz, damping, delay_s=2e-4):
    s, w = 2j * np.pi * HERTZ, 2 * np.pi * mode_Hz
    return gain * np.exp(-s * delay_s) * w**2 / (s**2 + 2 * damping * w * s + w**2)


@pytest.mark.parametrize(("gain", "mode_Hz", "damping"), [(5.0, 67.0, 0.02), (4.2, 52.0, 0.005), (6.0, 81.0, 0.1)])
def test_a_flexure_is_what_it_is(gain, mode_Hz, damping):
    found = plant_figures(measured(flexure(gain, mode_Hz, damping)), measured(np.full(len(HERTZ), 0.61)), NEAR)
    expected = (gain, mode_Hz, damping, 0.61)
    assert (found.stage_gain, found.mode_Hz, found.mode_damping, found.actuator_um_per_V) == pytest.approx(
        expected, rel=1e-4
    )


def test_noise_and_a_mode_above_move_it_little():
    """A mode three times as high with a tenth of the gain is not in the model."""
    response = flexure(5.0, 67.0, 0.02) + flexure(0.5, 201.0, 0.02)
    found = [plant_figures(measured(response, 0.05, seed), None, NEAR) for seed in range(10)]
    assert np.mean([each.mode_Hz for each in found]) == pytest.approx(67.0, rel=0.005)
    assert np.std([each.mode_Hz for each in found]) < 0.3
    assert np.mean([each.mode_damping for each in found]) == pytest.approx(0.02, rel=0.25)


def test_the_models_figures_are_what_would_be_measured_of_it():
    """A second mode bends the response about the first: its gain there is 11 % less than at rest."""
    period_s, parts = 1e-4, []
    for gain, mode_Hz, damping in ((4.8, 72.0, 0.02), (1.0, 150.0, 0.02)):
        w = 2 * np.pi * mode_Hz
        A, B = np.array([[0.0, 1.0], [-w * w, -2 * damping * w]]), np.array([[0.0], [w * w]])
        parts.append(cont2discrete((A, B, np.array([[gain, 0.0]]), np.zeros((1, 1))), period_s))
    (A, B, C, *_), (A2, B2, C2, *_) = parts
    model = System(block_diag(A, A2), np.concatenate([B, B2])[:, 0], np.concatenate([C, C2], axis=1)[0], 0.0, period_s)
    said = commissioned(model)
    omega = 2 * np.pi * HERTZ
    seen = plant_figures(measured(model.response(omega) * np.exp(-1j * omega * 2e-4)), None, said)
    for name in ("stage_gain", "mode_Hz", "mode_damping"):
        assert getattr(said, name) == pytest.approx(getattr(seen, name), rel=0.01), name
    at_rest = model.response(np.array([2 * np.pi]))[0].real
    assert said.stage_gain < 0.95 * at_rest, "else the case asks for nothing"


def said(figures=NEAR, deviations=None, **margins):
    margins = {"stage_gain_dB": 7.5, "stage_phase_deg": 37.0} | margins
    return list(problems_of(Check("x", figures, NEAR, margins, deviations or {}), Accept()))


def test_a_figure_outside_what_robustness_was_judged_for_is_named():
    assert said(PlantFigures(5.0, 60.0, 0.025)) == []
    assert said(PlantFigures(5.0, 52.0, 0.02)) == [
        "mode_Hz is 52, 67 in the model: robustness was judged within -16 to +20 % of it"
    ]
    assert said(PlantFigures(stage_gain=5.0)) == [], "no mode was found that could have moved"


@pytest.mark.parametrize(
    ("phase_deg", "deviation_deg", "wanted"),
    [
        (34.7, None, []),
        (32.0, 2.0, []),
        (32.0, None, ["stage_phase_deg is 32: at least 35 is asked for (`accept`)"]),
        (30.0, 2.0, ["stage_phase_deg is 30, known to 4: at least 35 is asked for (`accept`)"]),
    ],
)
def test_a_margin_that_is_not_surely_below_is_no_alarm(phase_deg, deviation_deg, wanted):
    deviations = {} if deviation_deg is None else {"stage_phase_deg": deviation_deg}
    assert said(deviations=deviations, stage_phase_deg=phase_deg) == wanted
