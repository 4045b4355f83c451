"""At the spindle, in virtual time: path deviation and machining force of the simulated cell."""

import re

import numpy as np
import pytest
from scipy.optimize import least_squares

from campaigns.report import CONFIG
from micromanip.design.experiment import with_axes, with_reference
from micromanip.rt.states import NO_FAULT, TOOTH_LOST, TRACKING
from micromanip.settings.check import prepare
from micromanip.settings.schema.reference import File, Hold
from micromanip.virtual.experiment import VirtualExperiment

ENTERED_S, CYCLES = 4.0, 35_000


def tracked(tmp_path, range_percent, tooth_Hz):
    """Rms (um) of the axes' path errors in the last second of a cut, the telemetry of all of it, and the cell."""
    text = SIMULATED.read_text(encoding="utf-8")
    assert text.count(FORCE) == 1
    text = text.replace(FORCE, f"force: {{start_s: {ENTERED_S}, tooth_Hz: {tooth_Hz}}}")
    text, axes = re.subn("oscillation_range_percent: .*", f"oscillation_range_percent: {range_percent}", text)
    assert axes == 3
    file = tmp_path / "cell.yaml"
    file.write_text(text, encoding="utf-8")
    prepared = prepare(file)
    cell = VirtualExperiment(prepared, process=True).cell(prepared.configuration)
    cell.arm(every=1000)
    cell.run(ENTERED_S - float(cell.state[0]["cycle"]) * 1e-4, every=1000)
    rows = cell.run(1e-4 * CYCLES)["axis"]
    assert (cell.state[0]["state"], cell.state[0]["fault"]) == (TRACKING, NO_FAULT)
    return np.sqrt(np.mean(rows["path_error_um"][-10_000:, :3] ** 2, axis=0)), rows, cell


def told(cell):
    return [(int(e["code"]), int(e["axis"]), float(e["value"]), float(e["limit"])) for e in cell.state[0]["event"]]


def test_the_speed_is_found_and_costs_nothing_any_more(tmp_path):
    exact, _, _ = tracked(tmp_path, 0.0, 200.0)
    fixed, fixed_rows, _ = tracked(tmp_path, 0.0, 204.0)
    followed, rows, cell = tracked(tmp_path, 3.0, 204.0)
    assert (fixed > 2.5 * exact).all()
    assert followed == pytest.approx(exact, rel=0.05)
    assert rows["tooth_Hz"][-1] == pytest.approx(204.0, abs=0.1)
    assert np.isnan(fixed_rows["tooth_Hz"]).all()
    assert TOOTH_LOST not in [code for code, *_ in told(cell)]


SIMULATED = CONFIG / "simulated.yaml"


def variant(tmp_path, **replaced):
    """The tuned configuration with lines replaced."""
    text = SIMULATED.read_text(encoding="utf-8")
    for old, new in replaced.values():
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "variant.yaml"
    file.write_text(text, encoding="utf-8")
    return prepare(file)


def improvement(prepared, seconds=6.0):
    """Uncompensated over compensated rms of each axis."""
    cell = VirtualExperiment(prepared, process=True).cell(prepared.configuration)
    cell.arm()
    cell.run(seconds, every=100)
    axes = cell.state[0]["figures"]
    assert (axes["errors"] > 4.0 * 10_000).all()
    return np.sqrt(axes["uncompensated_squares"] / axes["error_squares"])


def test_thirty_times_better_with_the_trackers_samples_held(tmp_path):
    assert (improvement(variant(tmp_path, held=("predict: true", "predict: false"))) >= 30.0).all()


def test_a_hundred_times_better_with_them_predicted():
    assert (improvement(prepare(SIMULATED)) >= 100.0).all()


STEP = "force: {start_s: 4.0, static_N: 5.0, rise_ms: 0.01, tooth_N: 0.0, noise_N: 0.0}"
NONE = "force: {start_s: 4.0, static_N: 0.0, tooth_N: 0.0, noise_N: 0.0}"
FORCE = "force: {start_s: 5.0, static_N: 80.0, tooth_N: 40.0, tooth_Hz: 200.0, noise_N: 5.0}"


def force_response(tmp_path, mode):
    """Stage motion (um, axis x) after a step of 5 N: the difference of two runs with the same noise."""
    positions = []
    for force in (STEP, NONE):
        prepared = variant(tmp_path, force=(FORCE, force))
        configuration = with_axes(prepared.configuration, mode=mode)
        if mode == "strain":
            configuration = with_reference(configuration, Hold(source="hold", offset_um=66.0))
        cell = VirtualExperiment(prepared, process=True).cell(configuration)
        cell.arm()
        before_s = 4.0 - float(cell.state[0]["cycle"]) * 1e-4
        rows = cell.run(before_s + 0.5)
        positions.append(rows["axis"]["true_stage_um"][round(before_s * 1e4) :, 0])
    return positions[0] - positions[1]


def damped_mode(response, skip, count):
    """Frequency (Hz) and damping ratio of the mode that dominates a free response."""
    t = np.arange(count) * 1e-4
    y = response[skip : skip + count]

    def residual(x):
        omega, zeta = 2 * np.pi * x[0], x[1]
        swing = omega * np.sqrt(max(1e-9, 1 - zeta**2)) * t
        envelope = np.exp(-zeta * omega * t)
        slow = np.exp(-t * np.exp(x[2]))
        basis = np.column_stack([envelope * np.cos(swing), envelope * np.sin(swing), slow, np.ones_like(t)])
        return basis @ np.linalg.lstsq(basis, y, rcond=None)[0] - y

    starts = [(f, z, s) for f in (50.0, 66.0, 95.0) for z in (0.02, 0.3, 0.6) for s in (3.0, 5.0)]
    bounds = ([20.0, 1e-3, 0.0], [400.0, 0.99, 8.0])
    best = min(
        (least_squares(residual, start, bounds=bounds, x_scale=(10, 0.1, 1)) for start in starts), key=lambda s: s.cost
    )
    assert np.sqrt(2 * best.cost / count) < 0.15 * y.std(), "one mode and one slow course are most of it"
    return best.x[0], best.x[1]


@pytest.mark.long
def test_the_outer_loop_damps_the_resonance(tmp_path):
    ringing = force_response(tmp_path, "strain")
    frequency, damping = damped_mode(ringing, 0, 4000)
    assert frequency == pytest.approx(65.7, abs=1.5)
    assert damping < 0.03
    held = force_response(tmp_path, "stage")
    _, damped = damped_mode(held, 0, 400)
    assert damped >= 0.3
    # and the force is cancelled: what is left after 0.3 s is a small part of what an open loop gives way
    assert np.abs(held[3000:]).max() < 0.05 * np.abs(ringing[3000:].mean())
    assert np.abs(held).max() < np.abs(ringing).max()


@pytest.mark.parametrize("kick_um", [20.0, 100.0, 200.0])
def test_a_kick_of_the_reference_dies_away(kick_um):
    """Set-point and voltage run into their limits for 30 ms; that must not leave the loop swinging."""
    prepared = prepare(SIMULATED)
    samples = np.zeros((6000, 3))
    samples[1000:1300] = kick_um
    played = with_reference(prepared.configuration, File(source="file", path="(kick)"))
    stage = VirtualExperiment(prepared)(played, 0.6, samples)["axis"]["stage_um"]
    assert np.abs(stage[1000:1300]).max() > 0.9 * kick_um
    assert np.abs(stage[-500:]).max() < 0.2
