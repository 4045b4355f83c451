"""A correction on the simulated cell: it does what the model says, is seen in the recording, and keeps every limit."""

import numpy as np
import pytest

from micromanip.control.learned import Played, fill_learned, rows_to_play
from micromanip.design.learning import transfer
from micromanip.design.learning.transfer import Transfer
from micromanip.design.learning.zero_phase import answered
from micromanip.rt.states import BEGIN_PART, TRACKING
from micromanip.virtual.experiment import VirtualExperiment

from .played import SECONDS

pytestmark = pytest.mark.long

RATE_HZ, LOOP_HZ = 1000.0, 10_000.0
TIME_S = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
CORRECTION = 0.4 * np.sin(2 * np.pi * 8.0 * TIME_S) + 0.2 * np.sin(2 * np.pi * 35.0 * TIME_S)


@pytest.fixture(scope="module")
def corrected(cell, prepared, quiet, noisy):
    cell.memories = {}
    cell.learn(*noisy, "a part to know the grid by")
    return cell.make(None, dict.fromkeys(prepared.configuration.axes, CORRECTION))


def test_the_stage_does_what_the_model_says(cell, quiet, corrected):
    """The path is the same to the last bit, so what the errors differ by is what the correction has moved."""
    without, with_it = (cell.true_error(*made) for made in (quiet, corrected))
    for name, way in cell.ways.items():
        moved = (without[name] - with_it[name])[:: round(LOOP_HZ / RATE_HZ)]
        expected = answered(CORRECTION, RATE_HZ, way.response)
        inside = slice(100, None)  # behind the fade
        assert np.std((moved - expected)[inside]) < 0.03 * np.std(expected[inside]), name
        assert np.std((moved - CORRECTION)[inside]) < 0.1 * np.std(CORRECTION)


def test_what_was_played_is_read_off_the_recording(cell, prepared, noisy, corrected):
    for index, name in enumerate(prepared.configuration.axes):
        for (rows, begin_s), played in ((noisy, 0.0 * CORRECTION), (corrected, CORRECTION)):
            part = cell.run_of(rows, name, "run").part(begin_s, SECONDS)
            assert part.played_um[100:-10] == pytest.approx(played[100:-10], abs=1e-4)
            assert part.missed == 0.0
            measured = rows["axis"][round(begin_s * LOOP_HZ) :][::10][: len(part.path_um)]["stage_um"][:, index]
            assert part.path_um - part.error_um == pytest.approx(measured, abs=0.2)


def test_an_uncertain_transfer_is_not_used_beyond_what_it_is_known_to(cell, monkeypatch):
    way = Transfer(cell.ways["x"].laws, draws=6)
    hertz = np.arange(1.0, 150.0)
    off = way.off(hertz)
    known_to = 0.5 * off.max()
    monkeypatch.setattr(transfer, "MOST_OFF", known_to)
    assert 20.0 < way.highest_Hz < 150.0
    assert off[hertz <= way.highest_Hz].max() <= known_to
    assert np.isinf(way.off(np.array([500.0]))).all()
    assert abs(way.response(hertz[:20]) - 1.0).max() < 0.01, "where the loop follows"
    assert (Transfer(cell.ways["x"].laws, draws=12).off(hertz) >= off - 1e-12).all(), "more plants, not less doubt"


def test_a_memory_gone_wild_leads_no_set_point_and_no_voltage_out_of_its_limits(prepared):
    """Jumps of a hundred micrometres in every cycle, unlimited by the law itself."""
    configuration = prepared.configuration
    wild = np.random.default_rng(3).normal(scale=100.0, size=300)
    rows = rows_to_play(dict.fromkeys(range(3), (wild, wild)), LOOP_HZ, LOOP_HZ)
    cell = VirtualExperiment(prepared).cell(configuration, rows)
    cell.arm()
    before = cell.run(0.05)
    for i in range(3):
        fill_learned(cell.parameters[0]["axis"][i]["learned"], 1, i, len(rows), Played(1e6, np.inf), LOOP_HZ)
    played = np.concatenate([before[-1:], cell.run(0.1, command=BEGIN_PART)])
    assert played["state"][1] == TRACKING
    for i, (name, axis) in enumerate(configuration.axes.items()):
        output, one = configuration.outputs[f"voltage_{name}"], played["axis"][:, i]
        for column, (low, high), per_ms in (
            ("setpoint_um", axis.setpoint.range_um, axis.setpoint.slew_um_per_ms),
            ("voltage_V", output.range_V, output.slew_V_per_ms),
        ):
            assert one[column].min() >= low
            assert one[column].max() <= high
            assert np.abs(np.diff(one[column])).max() <= per_ms * 1e3 / LOOP_HZ * (1.0 + 1e-9)
        assert np.ptp(one["setpoint_um"]) > 10.0, "it was played"
