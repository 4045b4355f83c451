"""``fit linear``: the documented keys, CSV by name and text by number, several files; errors in one line."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from campaigns.report import CONFIG
from micromanip.settings.load import load_with_source
from micromanip.settings.schema.axis import LinearModel, Outer
from tests.cli import command

FACTORY = CONFIG / "factory.yaml"
STAGE = ("--input", "setpoint_um", "--output", "stage_um", "--axis", "x")
OMEGA, DAMPING = 2 * np.pi * 60.0, 0.05
CONTINUOUS = np.array([[0.0, 1.0], [-(OMEGA**2), -2 * DAMPING * OMEGA]]), np.array([[0.0], [OMEGA**2]])
A, B, C, _, _ = cont2discrete((*CONTINUOUS, np.array([[1.0, 0.0]]), np.zeros((1, 1))), 1e-4)
MODE = LinearModel(A=A.tolist(), B=B[:, 0].tolist(), C=C[0].tolist(), delay_cycles=6)
"""At 60 Hz, at 10 kHz."""


@pytest.fixture
def cell(tmp_path):
    file = tmp_path / "cell.yaml"
    file.write_text(FACTORY.read_text())
    return file


def stage(file, every=1, header="t_s,setpoint_um,stage_um", seconds=4.0, model=MODE):
    """What answers a set-point that is held for `every` cycles, each of which makes a row."""
    A, B, C = (np.array(each) for each in (model.A, model.B, model.C))
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(round(seconds * 1e4 / every)), every)
    late = np.concatenate([np.zeros(model.delay_cycles), u])
    x, y = np.zeros(len(A)), np.empty(len(u))
    for k in range(len(u)):
        y[k] = C @ x
        x = A @ x + B * late[k]
    y += 1e-3 * y.std() * rng.standard_normal(len(y))
    t = 1e-4 * np.arange(len(u))
    np.savetxt(file, np.column_stack([t, u, y])[::every], "%.9g", ",", header=header, comments="")
    return file


def response(model, hertz):
    z = np.exp(2j * np.pi * 1e-4 * hertz)
    A, B, C = (np.array(each) for each in (model.A, model.B, model.C))
    return np.array([C @ np.linalg.solve(point * np.eye(len(A)) - A, B) for point in z]) * z**-model.delay_cycles


@pytest.mark.parametrize(("every", "name"), [(1, "simulated"), (2, "factory")])
def test_the_model_in_the_configuration_is_that_of_the_record(every, name, cell, tmp_path, capsys):
    """Weights stay where there is an outer loop, as in the first, and are the defaults where there is none."""
    cell.write_text(before := FACTORY.with_stem(name).read_text())
    was = load_with_source(cell)[0].axes["x"].outer
    model = was.model if was else MODE
    file = stage(tmp_path / "x.csv", every, seconds=2.0 * every, model=model)
    assert code_of(file, *STAGE, "--order", len(model.A), "--into", cell) == 0
    assert "wrote axes.x.outer.model of" in capsys.readouterr().out
    assert command.code_of("check", cell) == 0
    outer = load_with_source(cell)[0].axes["x"].outer
    assert outer == (Outer(model=outer.model) if was is None else was.model_copy(update={"model": outer.model}))
    hertz = np.array([1.0, 30.0, 55.0, 60.0, 65.0, 200.0])
    assert np.abs(response(outer.model, hertz) / response(model, hertz) - 1.0).max() < 0.02
    comments = [[line for line in text.splitlines() if "#" in line] for text in (before, cell.read_text())]
    assert comments[0] == comments[1]


NOT_TAKEN = {
    "no units": ("t_s,setpoint,stage", ("setpoint", "stage"), 1, "setpoint states no unit"),
    "a voltage": ("t_s,u_V,stage_um", ("u_V", "stage_um"), 1, "u_V is in V: of linear models a configuration holds"),
    "no axis": ("t_s,a_um,b_um", ("a_um", "b_um"), 64, "w"),
}


@pytest.mark.parametrize("name", NOT_TAKEN)
def test_what_has_no_place_is_refused_and_nothing_is_written(name, cell, tmp_path, capsys):
    header, (driven, seen), code, said = NOT_TAKEN[name]
    before = cell.read_text()
    axis = "w" if name == "no axis" else "x"
    file = stage(tmp_path / "x.csv", 1, header, 0.1)
    assert code_of(file, "--input", driven, "--output", seen, "--into", cell, "--axis", axis) == code
    assert said in capsys.readouterr().err
    assert cell.read_text() == before


def test_a_rate_that_the_loop_s_is_no_multiple_of_is_refused(cell, tmp_path, capsys):
    file = stage(tmp_path / "x.csv")
    before = cell.read_text()
    assert code_of(file, *STAGE, "--resample", "3000", "--order", "2", "--into", cell) == 1
    assert "a step of 0.000333333 s, the loop one of 0.0001 s" in capsys.readouterr().err
    assert cell.read_text() == before


DT = 2e-3
POLES = 0.95 * np.exp(np.array([0.3j, -0.3j]))
COLUMNS = ("--input", "u1,u2", "--output", "y1,y2")


def signals(seed=1, samples=2000, noise=0.01):
    """Two inputs; y1 rings and answers u1 three samples late, y2 is a lag of both."""
    rng = np.random.default_rng(seed)
    u = rng.normal((5.0, 0.0), 1.0, (samples, 2))
    late = np.concatenate([np.zeros(3), u[:-3, 0]])
    y1 = lfilter([0.0, 0.3], np.poly(POLES).real, late)
    y2 = lfilter([0.0, 0.2], [1.0, -0.8], late + 2.0 * u[:, 1]) + 7.0
    y = np.column_stack([y1, y2])
    return u, y + noise * y.std(axis=0) * rng.normal(size=y.shape)


def record(file, seed=1, dt=DT, **named):
    """CSV with a header: t_s, u1, u2, y1, y2."""
    u, y = signals(seed, **named)
    t = dt * np.arange(len(u))
    np.savetxt(file, np.column_stack([t, u, y]), "%.12g", ",", header="t_s,u1,u2,y1,y2", comments="")
    return str(file)


code_of = partial(command.code_of, "fit", "linear")


@pytest.fixture
def csv(tmp_path):
    return record(tmp_path / "x.csv")


def report_of(capsys, *arguments):
    assert code_of(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_json_has_the_documented_keys(csv, capsys):
    report = report_of(capsys, csv, *COLUMNS)
    assert {"order", "fit_percent", "rms_error_percent", "poles_z"} <= set(report)
    assert report["order"] == 3
    assert report["delay_samples"] == [3, 0]
    assert report["fit_percent"] == pytest.approx([99.0, 99.0], abs=0.3)
    assert np.add(report["fit_percent"], report["rms_error_percent"]) == pytest.approx([100.0, 100.0])
    poles = [complex(*pole) for pole in report["poles_z"]]
    assert sorted(poles, key=lambda p: (round(p.real, 3), p.imag)) == pytest.approx(
        [0.8, *sorted(POLES, key=lambda p: p.imag)], abs=0.01
    )
    assert report["poles_Hz"][0] == pytest.approx(abs(np.log(POLES[0])) / (2 * np.pi * DT), rel=0.01)
    assert report["dt_s"] == pytest.approx(DT)
    assert report["validation"] is None
    assert min(report["coherence"]) > 0.8
    A, B, C = (np.array(report[name]) for name in "ABC")
    assert (A.shape, B.shape, C.shape) == ((6, 6), (6, 2), (2, 6))
    gain = C @ np.linalg.solve(np.eye(6) - A, B)
    truth = [[0.3 / np.polyval(np.poly(POLES).real, 1.0), 0.0], [1.0, 2.0]]
    assert gain == pytest.approx(np.array(truth), abs=0.05)


REFUSED = {
    "no such column": (("--input", "u3", "--output", "y1"), 1, "there is no column u3"),
    "no such number": (("--input", "u1", "--output", "9"), 1, "there is no column 9"),
    "another rate": (("other.csv", *COLUMNS), 1, "other.csv: sampled every 0.004 s"),
    "no such file": ((*COLUMNS, "--validate", "none.csv"), 1, "none.csv: no such file"),
    "no table": (("table.py", *COLUMNS), 1, "table.py"),
    "input and output": (("--input", "u1", "--output", "u1"), 64, "u1"),
    "an empty name": (("--input", "u1,,u2", "--output", "y1"), 64, "--input u1,,u2"),
    "a name twice": (("--input", "u1,u1", "--output", "y1"), 64, "the column u1 is named twice"),
    "nothing to judge by": ((*COLUMNS, "--split", "1"), 64, "--split 1"),
    "no split": ((*COLUMNS, "--split", "0"), 64, "from 0.1 to 1"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name, csv, tmp_path, monkeypatch, capsys):
    arguments, code, named = REFUSED[name]
    monkeypatch.chdir(tmp_path)
    record("other.csv", 2, 2 * DT)
    Path("table.py").write_bytes(Path(__file__).read_bytes())
    assert code_of(csv, *arguments) == code
    assert named in capsys.readouterr().err
