"""Another tuning on a recording in which cycles are missing: figures only of moments that a recording tells of."""

import numpy as np
import pytest

from micromanip.replay.counterfactual import SETTLE_S, Rerun, predict
from micromanip.replay.fitting import fit_models
from micromanip.replay.window import take_window
from micromanip.settings.check import prepare

from .recorded import SIMULATED, recording, track
from .tuned import tuned

pytestmark = [pytest.mark.compiled_only, pytest.mark.long]
STALLS = [(0.8, 30), (2.5, 400), *((3.1 + 0.02 * k, 3) for k in range(20))]
"""Two that take the axes far away, and some that are too short to matter."""


@pytest.fixture(scope="module")
def stalled(tmp_path_factory):
    """The cell, and whatever is tried on its recording with stalls."""
    cell, file = prepare(SIMULATED), tmp_path_factory.mktemp("gaps") / "run.mcap"
    recorded = recording(file, cell, track(cell, cell.parameters, STALLS), samples=cell.samples)
    window = take_window(recorded)
    return cell, Rerun(window, fit_models(window, cell.configuration))


def test_what_counts_lies_away_from_long_gaps(stalled):
    _, rerun = stalled
    window = rerun.window
    settle = rerun.first - window.first
    (long,) = np.nonzero(window.rows["periods"] > 20)
    assert len(long) == 2
    for row in long:
        assert not rerun.counts[row - 1 : row + settle].any()
        assert rerun.counts[row + settle]
    assert rerun.counts[window.rows["periods"] == 3].all()
    missed_s = float((window.rows["periods"][long] - 1).sum()) * window.period_ns * 1e-9
    assert rerun.left_out_s == pytest.approx(missed_s + len(long) * SETTLE_S, rel=0.15)


@pytest.mark.parametrize(
    "values",
    [{"outer.control_weight": 100.0}, {"outer.oscillation_Hz": None}, {"inner.K_V_per_um": 0.03}],
    ids=lambda values: next(iter(values)),
)
def test_the_truth_is_within_the_range_where_it_counts(stalled, values):
    cell, rerun = stalled
    parameters = tuned(cell, {f"axes.{axis}.{key}": value for axis in "xyz" for key, value in values.items()})
    found = predict(rerun, parameters, draws=6)
    truth = rerun.figures(track(cell, parameters, STALLS, rerun.window))
    assert (found.expected.low_um <= truth).all()
    assert (truth <= found.expected.high_um).all()
    assert (np.abs(truth[0] / found.recorded[0] - 1.0) > 0.02).all(), "another tuning changes something"
