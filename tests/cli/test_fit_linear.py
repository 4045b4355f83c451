"""``fit linear``: the documented keys, CSV by name and text by number, several files; errors in one line."""

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.design.identify.linear.test_predictor import looped

from . import command

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
    "no order": ((*COLUMNS, "--order", "0"), 64, "1<=x<=60"),
    "no output": (("--input", "u1"), 64, "--output"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name, csv, tmp_path, monkeypatch, capsys):
    arguments, code, named = REFUSED[name]
    monkeypatch.chdir(tmp_path)
    record("other.csv", 2, 2 * DT)
    Path("table.py").write_bytes(Path(__file__).read_bytes())
    assert code_of(csv, *arguments) == code
    assert named in capsys.readouterr().err


def test_an_unstable_plant_is_fitted_as_it_is_and_judged_ahead(tmp_path, capsys):
    u, y = looped(-20.0)
    file = tmp_path / "x.csv"
    table = np.column_stack([0.01 * np.arange(len(u)), u, y])
    np.savetxt(file, table, "%.12g", ",", header="t_s,u_V,y_um", comments="")
    columns = ("--input", "u_V", "--output", "y_um")
    report = report_of(capsys, file, *columns, "--unstable")
    assert max(abs(complex(*pole)) for pole in report["poles_z"]) == pytest.approx(1.0457, abs=2e-3)
    assert report["foretold_samples"] == pytest.approx(22, abs=1)
    assert report["fit_percent"][0] > 90.0
    assert report["strict_fit_percent"] == [None]
    assert np.abs(np.linalg.eigvals(report["A"])).max() > 1.04
    assert code_of(file, *columns, "--unstable") == 0
    assert re.search(r"held out, y_um, 2\d samples ahead: fit 9", capsys.readouterr().out)
    assert code_of(file, *columns, "--unstable", "--into", file, "--axis", "x") == 64
