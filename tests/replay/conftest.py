"""The simulated cell recorded from before arming on, for whatever is tried on it."""

import pytest

from micromanip.settings.check import prepare

from .recorded import SIMULATED, recording, track


@pytest.fixture(scope="package")
def recorded(tmp_path_factory):
    """The cell, and its recording from before arming on."""
    cell = prepare(SIMULATED)
    file = tmp_path_factory.mktemp("counterfactual") / "run.mcap"
    return cell, recording(file, cell, track(cell, cell.parameters), samples=cell.samples)
