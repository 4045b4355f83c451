"""The step response out of ordinary running against the closed form, and where it says that it can't tell."""

import re
from pathlib import Path

import numpy as np
import pytest
from replay.recorded import recording
from scipy.signal import butter, lfilter, sosfiltfilt

from micromanip.design.deconvolution import SHOWN_S, StepSpectra
from micromanip.design.recorded_run import RecordedRun
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell

CONFIG = Path(__file__).parents[2] / "config" / "simulated.yaml"
RATE_HZ = 10_000.0
OMEGA, DAMPING = 2 * np.pi * 150.0, 0.3


def closed_form(t_s):
    """Step response of w^2 / (s^2 + 2 d w s + w^2)."""
    fast = OMEGA * np.sqrt(1 - DAMPING**2)
    after = np.maximum(t_s, 0.0)
    ring = np.cos(fast * after) + DAMPING / np.sqrt(1 - DAMPING**2) * np.sin(fast * after)
    return np.where(t_s > 0, 1 - np.exp(-DAMPING * OMEGA * after) * ring, 0.0)


def response(*records):
    """Step response out of records one behind the other, each an input and an output."""
    found, begin = StepSpectra(RATE_HZ), 0
    for u, y in records:
        found.add(begin + np.arange(len(u)), u, y)
        begin += len(u) + 100  # more than what is bridged
    return found.response()


def second_order(u):
    """The same, sampled (step invariant): each sample of `u` holds until the next."""
    step = closed_form(np.arange(3) / RATE_HZ)
    decay = np.exp(-DAMPING * OMEGA / RATE_HZ)
    a1, a2 = -2 * decay * np.cos(OMEGA * np.sqrt(1 - DAMPING**2) / RATE_HZ), decay**2
    b1 = step[1]
    b2 = step[2] + (a1 - 1.0) * step[1]
    return lfilter([0.0, b1, b2], [1.0, a1, a2], u)


def ordinary(seed, seconds, noise_um, calm=1.0):
    """A stroke of 40 um at 2 Hz with a little that is fast on it, as an outer loop gives it, and a noisy gauge."""
    draw = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    fast = lfilter([0.1], [1, -0.9], draw.standard_normal(len(t)))
    u = 40 * np.sin(2 * np.pi * 2 * t + seed) + calm * fast
    return u, second_order(u) + noise_um * draw.standard_normal(len(t))


def test_a_known_second_order_system():
    """Within 1 % of the closed form everywhere, and the band holds it about as often as it says."""
    inside = []
    for seed in range(12):
        found = response(ordinary(seed, 20.0, 0.02))
        assert found.problem is None
        assert found.is_whole
        truth = closed_form(found.t_s)
        assert np.abs(found.response - truth).max() < 0.02
        assert found.overshoot_percent[0] == pytest.approx(100 * (truth.max() - 1.0), abs=1.5)
        inside += [np.mean((found.low <= truth) & (truth <= found.high))]
    assert 0.85 < np.mean(inside) < 0.999
    assert found.t_s[-1] == pytest.approx(SHOWN_S, abs=2 / RATE_HZ)


@pytest.mark.parametrize(
    ("calm", "noise_um", "seconds", "problem"),
    [
        (0.0, 0.02, 20.0, "excited too weakly"),  # a sine is no excitation, however large
        (0.0, 0.0, 20.0, "excited too weakly"),  # nor where there is no noise to hide it
        (1e-3, 0.2, 20.0, "excited too weakly"),
        (1.0, 0.02, 3.0, "too short"),
    ],
)
def test_what_can_not_be_told_is_said(calm, noise_um, seconds, problem):
    found = response(ordinary(1, seconds, noise_um, calm))
    assert found.problem.startswith(problem)
    assert not len(found.response)


def with_a_step(folder, step_um):
    """Set-point and gauge of axis x (um) under strain control: a step of the set-point, with the noise of that seed.

    As it is below the outer loop, where nothing of the actuator is undone.
    """
    source = "reference: {source: step, offset_um: 60.0, step_um: STEP, start_s: 0.1}\n\n".replace("STEP", str(step_um))
    text = re.sub(r"reference:\n  source: signal.*?\n(?=axes:)", source, CONFIG.read_text(), flags=re.DOTALL)
    text = re.sub(r"    actuator:.*?(?=    commissioned:)", "", text, flags=re.DOTALL)
    (folder / "step.yaml").write_text(text.replace("mode: stage ", "mode: strain "))
    prepared = prepare(folder / "step.yaml")
    cell = VirtualCell(prepared.parameters.copy(), prepared.wiring)
    x = np.concatenate([cell.arm(), cell.run(0.3)])["axis"][:, 0]
    return x["setpoint_um"], x["strain_um"]


@pytest.mark.compiled_only
@pytest.mark.long
def test_the_simulated_cell_answers_a_true_step_as_was_read_off_its_running(tmp_path):
    """Deconvolved from tracking with machining, against a step less the same run without it, both up to 1 kHz."""
    prepared = prepare(CONFIG)
    cell = VirtualCell(prepared.parameters.copy(), prepared.wiring)
    rows = np.concatenate([cell.arm(), cell.run(10.0)])
    found = RecordedRun(recording(tmp_path / "run.mcap", prepared, rows)).axis["x"].steps.response()
    assert found.problem is None
    (setpoint, stepped), (_, still) = (with_a_step(tmp_path, step_um) for step_um in (1.5, 0.0))
    at = int(np.flatnonzero(np.diff(setpoint) > 1.0)[0]) + 1 - int(np.searchsorted(found.t_s, 0.0))
    slow = butter(4, 1000.0, output="sos", fs=RATE_HZ)
    truth = sosfiltfilt(slow, (stepped - still)[at : at + len(found.t_s)] / 1.5)
    answer = sosfiltfilt(slow, found.response)
    assert answer.max() == pytest.approx(truth.max(), abs=0.03)
    assert np.abs(answer - truth)[found.t_s < 2e-3].max() < 0.03
    assert np.abs(answer - truth).max() < 0.05  # the last 3 % of a single step creep: no linear answer
