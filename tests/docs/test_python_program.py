"""The program of docs/record-and-replay.md, from a recording to a controller, on a stage that is known."""

import re
from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, lfilter

PAGE = Path(__file__).parents[2] / "docs" / "record-and-replay.md"
PERIOD_S, MODE_Hz = 1e-4, 120.0


def saved(file, header, *columns):
    np.savetxt(file, np.column_stack(columns), "%.9g", ",", header=header, comments="")


def play(u, radius):
    x, played = u[0], np.empty_like(u)
    for k, value in enumerate(u):
        played[k] = x = max(value - radius, min(value + radius, x))
    return played


def test_the_program_goes_from_recordings_to_a_loop(tmp_path, monkeypatch, capsys):
    rng = np.random.default_rng(1)
    t = 2e-3 * np.arange(3000)
    u = 75.0 - (40.0 + 20.0 * np.cos(np.pi * t / 6.0)) * np.cos(2 * np.pi * t)
    y = 0.5 * u + sum(0.04 * play(u, 5.0 * k) for k in range(1, 6)) + 0.01 * rng.standard_normal(len(t))
    saved(tmp_path / "actuator.csv", "t_s,voltage_V,strain_um", t, u, y)
    w = 2 * np.pi * MODE_Hz
    b, a, _ = cont2discrete(([w**2], [1.0, 0.8 * w, w**2]), PERIOD_S)
    setpoint = 50.0 + 5.0 * np.repeat(rng.choice([-1.0, 1.0], 400), 20)
    late = np.concatenate([np.full(4, setpoint[0]), setpoint[:-4]])
    stage = 50.0 + lfilter(b.ravel(), a, late - 50.0) + 0.01 * rng.standard_normal(len(late))
    saved(tmp_path / "stage.csv", "t_s,setpoint_um,stage_um", PERIOD_S * np.arange(len(late)), setpoint, stage)
    (program,) = re.findall(r"```python\n([^`]*tune_outer[^`]*)```", PAGE.read_text(encoding="utf-8"))
    assert len([line for line in program.splitlines() if line]) <= 30
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(program, names)
    shown = capsys.readouterr().out
    assert names["hysteresis"].rms_percent < 0.1, shown
    poles = np.abs(np.log(names["found"].model.poles)) / (2 * np.pi * PERIOD_S)
    np.testing.assert_allclose(poles, MODE_Hz, rtol=0.03)
    assert names["design"].margins.gain_dB >= 6.0
    assert names["design"].bandwidth_Hz > MODE_Hz
    assert names["design"].step.overshoot < 0.2
    assert "order 2, fit 99." in shown
    assert "8000 samples every 0.0001 s" in shown
