"""What a fitted predictor leaves of tracker and path: beside the causal bound, and computed beside played."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from micromanip.design.analyse.budget.causes import Grid, followed_line, tracker_noise
from micromanip.design.analyse.budget.configured import cell_of
from micromanip.design.identify.tracker.fit import fit_deviation
from micromanip.settings.check import prepare
from micromanip.settings.schema.reference import AxisDeviation

SIMULATED = Path(__file__).parents[4] / "config" / "simulated.yaml"
SECONDS = 10.0


@pytest.fixture(scope="module")
def cell():
    return cell_of(prepare(SIMULATED), "x")


def samples_of(cell, noise_um, seconds=SECONDS, seed=1):
    """Times (n,) and samples (n,), um, of the cell's own deviation, with phases of their own."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(1000.0 * seconds)) * 1e-3
    path = sum(um * np.sin(2 * np.pi * (hertz * time_s + rng.uniform())) for hertz, um in cell.known.deviation)
    return time_s, path + rng.normal(0.0, noise_um, len(time_s))


def fitted(cell, noise_um):
    """The same cell with a tracker of `noise_um`, its predictor fitted to other samples of the path."""
    _, samples = samples_of(cell, noise_um)
    own = AxisDeviation.model_validate(fit_deviation(samples, 1000.0).settings())
    swings = [hertz for hertz, _ in cell.known.deviation]
    tracker = replace(
        cell.laws.tracker,
        oscillations=own.oscillations,
        jerk_um_per_s3=own.jerk_um_per_s3,
        noise_um=own.noise_um,
        steady=own.steady,
    ).at_swings(swings)
    return replace(
        cell,
        laws=replace(cell.laws, tracker=tracker),
        tracking=replace(cell.tracking, tracker=tracker),
        known=replace(cell.known, tracker_noise_um=noise_um),
    )


@pytest.mark.long
def test_what_is_computed_is_what_the_law_leaves_of_samples(cell):
    """Through the predictor alone, up to the row G: noise, and the path's own error of prediction."""
    own = fitted(cell, 0.5)
    laws, tracking = own.laws, own.tracking
    row, grid = laws.gains.reference, Grid(10_000.0, 4.0)
    loop = laws.around(laws.model(grid.omega), grid.omega)
    through = replace(loop, plant=np.ones_like(loop.plant), following=np.ones_like(loop.following), feedback=0.0)
    computed = tracker_noise(grid, through, tracking, row, 0.5).sum()
    time_s, _ = samples_of(own, 0.5, 40.0)
    rng = np.random.default_rng(9)
    lines = [(hertz, um, rng.uniform()) for hertz, um in own.known.deviation]
    clean = sum(um * np.sin(2 * np.pi * (hertz * time_s + phase)) for hertz, um, phase in lines)
    now_s = np.arange(round(40.0 * 10_000.0)) * 1e-4
    seen = [
        tracking.given(time_s, time_s + tracking.latency_s, samples, now_s, row)
        for samples in (clean, clean + rng.normal(0.0, 0.5, len(time_s)))
    ]
    ideal = np.zeros(len(now_s))
    for hertz, um, phase in lines:
        turned = np.exp(2j * np.pi * (hertz * now_s + phase))
        at = tracking.images(hertz)
        unity = replace(laws.around(laws.model(2 * np.pi * at), 2 * np.pi * at), plant=np.ones(len(at)), feedback=0.0)
        error = followed_line(replace(unity, following=np.ones(len(at))), tracking, row, hertz)
        ideal += um * np.imag((1.0 - error[0]) * turned)
    played = np.var((seen[1] - ideal)[100_000:])
    assert np.sqrt(played) == pytest.approx(np.sqrt(computed), rel=0.06)
