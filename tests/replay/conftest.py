"""The simulated cell recorded from before arming on, for whatever is tried on it."""

import pytest

from campaigns.counterfactual import record, recorded_cell, track
from micromanip.recordings import open_telemetry


@pytest.fixture(scope="package")
def recorded(tmp_path_factory):
    """The cell, and its recording from before arming on."""
    cell = recorded_cell()
    file = tmp_path_factory.mktemp("counterfactual") / "run.mcap"
    record(cell, track(cell, cell.parameters), file)
    return cell, open_telemetry(file)
