"""Measured recordings that others have published figures for; skipped where they are not beside the project."""

from pathlib import Path

import numpy as np
import pytest

from micromanip.design import fit_linear
from micromanip.design.linear.experiments import load_linear
from micromanip.design.linear.judged import fit_records
from micromanip.recordings import Wanted

DATA = Path(__file__).parents[3].parent / "shared" / "data"


def folder(name):
    if not (DATA / name).is_dir():
        pytest.skip(f"the real recordings are not here: {name} is not beside the project")
    return DATA / name


@pytest.mark.parametrize(("name", "percent"), [("robot_arm", 96.0), ("dryer", 89.0)])
def test_daisy(name, percent):
    """Second half in free run, fitted on the first."""
    record = load_linear(folder("daisy") / f"{name}.dat", Wanted(("1", "2"), step_s=1.0), 1)
    result = fit_records([record], None, 4, 0.5)
    assert result.model.order == 4
    assert result.fit_percent[0] >= percent


@pytest.mark.thorough  # three inputs and outputs: test_fit.py; real recordings: the other tests here
@pytest.mark.long
def test_fine_steering_mirror():
    """Three inputs and outputs, order 28: as good as the published optimised linear model (4.54 / 7.02 / 5.35 %)."""
    u, y = (np.load(folder("fsm") / f"{name}_300mV_train.npy") for name in "uy")

    def realisation(number):
        return tuple(signal[:, :, number].transpose(2, 0, 1).reshape(-1, 3) for signal in (u, y))

    model = fit_linear([realisation(number) for number in range(5)], 1 / 6400, 28)
    _, rms = model.errors(*realisation(5))
    assert (rms <= [4.7, 7.0, 5.4]).all()
    assert np.abs(model.poles).max() < 1.0
