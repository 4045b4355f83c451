"""What the report's figures show of a run, at whatever rate the loop has."""

import numpy as np
import pytest

from micromanip.design.commission.plots import figure_9
from micromanip.design.evaluation import Run
from micromanip.rt.telemetry import ROW

HERTZ = 5.0


@pytest.mark.parametrize("rate_hz", [1000, 10000, 20000])
def test_the_control_error_stands_over_the_phase_of_the_sine(rate_hz):
    rows = np.zeros(2 * rate_hz, ROW)
    phase = 2.0 * np.pi * HERTZ * np.arange(len(rows)) / rate_hz
    rows["axis"]["reference_um"][:, 0] = np.sin(phase)
    plot, _ = figure_9([Run("A", HERTZ, rows, rate_hz, rate_hz)], 0)
    (curve,) = plot.curves
    assert curve.x[np.argmax(curve.y)] == pytest.approx(90.0, abs=3.0)
    assert curve.y == pytest.approx(np.sin(np.radians(curve.x)), abs=0.05)
