"""Another tuning on what was recorded: the recorded one to the last bit, others beside their true re-simulation."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from cli.command import code_of
from scipy.signal import lfilter

from micromanip.errors import CheckFailed
from micromanip.replay.counterfactual import Rerun, predict
from micromanip.replay.fitting import fit_models
from micromanip.replay.self_replay import first_mismatch
from micromanip.replay.window import recorded_configuration, take_window

from .recorded import SIMULATED
from .tuned import tuned

pytestmark = [pytest.mark.compiled_only, pytest.mark.long]
PART = (5.5, 6.5)


@pytest.fixture(scope="module")
def rerun(recorded):
    _, telemetry = recorded
    window = take_window(telemetry, PART)
    return Rerun(window, fit_models(window, recorded_configuration(telemetry)[1]))


def weighted(text, control_weight):
    """The configuration with that weight in all axes."""
    text, axes = re.subn(r"control_weight: .*", f"control_weight: {control_weight}", text)
    assert axes == 3
    return text


@pytest.mark.parametrize("cut", [None, PART])
def test_the_recorded_tuning_is_what_was_recorded(recorded, cut):
    cell, telemetry = recorded
    window = take_window(telemetry, cut)
    assert (window.first > 0) == (cut is None)
    rerun = Rerun(window, fit_models(window, cell.configuration))
    assert first_mismatch(window.rows, rerun.rows(cell.parameters), window.axes) is None
    if cut is not None:
        found = predict(rerun, cell.parameters, draws=3)
        for um in (found.expected.um, found.expected.low_um, found.expected.high_um):
            assert (um == found.recorded).all()
        assert found.limits == found.recorded_limits


def test_the_stage_moves_as_its_model_says(recorded, rerun):
    """With the strain loop as it was, what the stage does otherwise is the model's answer to the other set-point.

    Not to the last digit: the plays of the hysteresis bend what the strain loop makes of it.
    """
    cell, _ = recorded
    rows = rerun.rows(tuned(cell, {"axes.x.outer.control_weight": 60.0}))["axis"][:, 0]
    was, model = rerun.window.rows["axis"][:, 0], cell.configuration.axes["x"].outer.model
    values, vectors = np.linalg.eig(np.array(model.A))
    residues = (np.array(model.C) @ vectors) * np.linalg.solve(vectors, np.array(model.B))
    moved = rows["setpoint_um"] - was["setpoint_um"]
    late = np.concatenate([np.zeros(1 + model.delay_cycles), moved])[: len(moved)]
    modes = zip(residues, values, strict=True)
    expected = np.real(sum(lfilter([r], [1.0, -p], late.astype(complex)) for r, p in modes))
    found = rows["stage_um"] - was["stage_um"]
    assert found.std() > 0.2
    assert (found - expected).std() < 0.15 * found.std()
    assert np.allclose(found, was["path_error_um"] - rows["path_error_um"], atol=1e-9)


def test_limits_that_another_tuning_meets(recorded, rerun):
    cell, _ = recorded
    rows = rerun.window.rows["axis"]["setpoint_um"][:, 0]
    narrow = [float(np.quantile(rows, 0.2)), float(np.quantile(rows, 0.8))]
    found = predict(rerun, tuned(cell, {"axes.x.outer.control_weight": 0.03}), draws=2)
    assert {"set-point slew"} <= {met.limit for met in found.limits} - {met.limit for met in found.recorded_limits}
    parameters = cell.parameters.copy()
    parameters["axis"]["setpoint_low_um"][0, 0], parameters["axis"]["setpoint_high_um"][0, 0] = narrow
    found = predict(rerun, parameters, draws=2)
    stroke = next(met for met in found.limits if met.limit == "stroke")
    assert (stroke.axis, stroke.value) == ("x", f"{narrow[0]:g}..{narrow[1]:g} um")
    assert PART[0] <= stroke.first_s <= PART[1]
    assert found.expected.um[0, 0] > 2.0 * found.recorded[0, 0]


def test_a_tuning_that_would_stop_the_cell(recorded, tmp_path, capsys):
    """A watch that trips where the recorded tuning was far from its limit."""
    cell, telemetry = recorded
    tight = "    faults: {following_error: {limit_um: 1.0, time_ms: 0.5}}\n"
    text = weighted(cell.source.text, 90.0)
    text = text.replace("    commissioned:\n", tight + "    commissioned:\n", 1)
    (tmp_path / "weak.yaml").write_text(text)
    assert code_of("replay", telemetry.file, "--with", tmp_path / "weak.yaml", "--cut", "6:7") == 1
    printed = capsys.readouterr().out
    assert "The cell would have stopped at 6." in printed
    assert re.search("x .* following error .* [0-9]", printed)


def test_the_command(recorded, tmp_path, capsys):
    cell, telemetry = recorded
    (tmp_path / "calm.yaml").write_text(weighted(cell.source.text, 60.0))
    given = ("replay", telemetry.file, "--with", tmp_path / "calm.yaml", "--cut", "5.5:6.5")
    assert code_of(*given, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["from_s"], document["armed"]) == (pytest.approx(5.5), False)
    assert document["seconds"] == pytest.approx(1.0)
    for error in document["errors"].values():
        low, high = error["predicted"]["rms_um_interval"]
        assert 0.0 < low < error["predicted"]["rms_um"] < high
        assert error["predicted"]["rms_um"] > 1.1 * error["recorded"]["rms_um"]
    assert code_of(*given) == 0
    printed = capsys.readouterr().out
    assert "Path error, um" in printed
    assert f"{document['errors']['x']['predicted']['rms_um']:.3f} (" in printed


@pytest.mark.parametrize(
    ("was", "is_", "says"),
    [
        ("rate_hz: 10000", "rate_hz: 9000", "loop.rate_hz is 9000, in .* it is 10000"),
        ("    seed: 1\n", "    seed: 2\n", "drivers.cell.seed is 2"),
        ("noise_um: 0.5}", "noise_um: 0.6}", "drivers.cell.tracker is "),
        ("source: signal", "source: hold", "reference.source is its own, in .* it is signal"),
        ("stage_x: {driver: cell,", "stage_x: {driver: cell, channel: stage_y,", "stage_x is cell:stage_y"),
    ],
)
def test_another_cell_is_refused(recorded, tmp_path, capsys, was, is_, says):
    _, telemetry = recorded
    text = SIMULATED.read_text().replace(was, is_, 1)
    if "hold" in is_:
        begin, end = text.index("  source: hold"), text.index("\naxes:")
        text = text[:begin] + "  source: hold\n  offset_um: 0\n" + text[end:]
    (tmp_path / "other.yaml").write_text(text)
    assert code_of("replay", telemetry.file, "--with", tmp_path / "other.yaml") in (64, 78)
    error = capsys.readouterr().err
    assert "Traceback" not in error
    (line,) = [line for line in error.splitlines() if line.startswith("micromanip: ")]
    assert re.search(says, line), line


def test_a_recording_that_says_too_little_is_refused(recorded, capsys):
    _, telemetry = recorded
    assert code_of("replay", telemetry.file, "--with", SIMULATED, "--cut", "5:5.2") == 1
    assert "no piece of 0.5 s tracks in it from 5 to 5.2 s" in capsys.readouterr().err
    assert code_of("replay", telemetry.file, "--with", SIMULATED, "--cut", "0:1") == 1
    assert "no piece of 0.5 s tracks" in capsys.readouterr().err
    assert code_of("replay", telemetry.file, "--cut", "5:6") == 64
    assert "--cut goes with --with" in capsys.readouterr().err
    with pytest.raises(CheckFailed, match="the loop's state is not in it"):
        take_window(replace(telemetry, state=None, states=()))
    with pytest.raises(CheckFailed, match="its configuration is not in it"):
        recorded_configuration(replace(telemetry, configuration=""))
    window = take_window(telemetry, PART)
    rare = window.rows.copy()
    rare["axis"]["fresh"][:, 1] &= ~1
    with pytest.raises(CheckFailed, match="the gauge of axis y is fresh in 0 % of the cycles"):
        fit_models(replace(window, rows=rare), recorded_configuration(telemetry)[1])
    still = window.rows.copy()
    still["axis"]["strain_um"][:, 2] = still["axis"]["voltage_V"][:, 2] = 50.0
    with pytest.raises(CheckFailed, match="the actuator of axis z can't be fitted: the rows show too little"):
        fit_models(replace(window, rows=still), recorded_configuration(telemetry)[1])
