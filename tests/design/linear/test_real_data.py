"""Measured recordings that others have published figures for; skipped where they are not beside the project."""

from pathlib import Path

import pytest

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
