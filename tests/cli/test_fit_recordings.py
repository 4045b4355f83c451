"""`fit` on recordings as people have them: options, what is told, exit codes, spikes that decide nothing."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from .test_fit_hysteresis import QUICK, code_of, record
from .test_fit_linear import code_of as linear_code
from .test_fit_linear import record as linear_record


def columns(file):
    return np.loadtxt(file, delimiter=",", skiprows=1).T


@pytest.fixture
def csv(tmp_path):
    return record(tmp_path / "x.csv", 1)


def figures(capsys, *arguments):
    assert code_of(*arguments, "--json") == 0
    shown = capsys.readouterr()
    return json.loads(shown.out), shown.err


def test_a_file_of_matlab_in_millimetres_and_milliseconds_is_the_same(csv, tmp_path, capsys):
    t, u, y = columns(csv)
    savemat(tmp_path / "x.mat", {"clock": 1e3 * t, "u": u, "y": 1e-3 * y})
    plain, _ = figures(capsys, csv, *QUICK)
    options = ("--time", "clock:ms", "--input", "u:V", "--output", "y:mm", *QUICK[4:])
    found, told = figures(capsys, tmp_path / "x.mat", *options)
    assert found["rms_percent"] == pytest.approx(plain["rms_percent"], rel=1e-3)
    assert "read x.mat: u in V, y in um; 3000 samples every 0.002 s (500 Hz), 6 s\n" in told
    assert "  note: y: mm turned into um\n" in told
    assert found["notes"] == ["y: mm turned into um"]


def test_a_file_of_another_program_in_mcap_is_the_same(csv, tmp_path, capsys):
    mcap = pytest.importorskip("mcap.writer")
    t, u, y = columns(csv)
    with (tmp_path / "x.mcap").open("wb") as out:
        writer = mcap.Writer(out)
        writer.start()
        channel = writer.register_channel("/axis", "json", 0)
        for t_s, u_V, y_um in zip(t, u, y, strict=True):
            at_ns = 10**18 + round(1e9 * t_s)
            writer.add_message(channel, at_ns, json.dumps({"drive": {"u": u_V}, "y": y_um}).encode(), at_ns)
        writer.finish()
    plain, _ = figures(capsys, csv, *QUICK)
    found, told = figures(capsys, tmp_path / "x.mcap", "--input", "/axis.drive.u:V", "--output", "y:um", *QUICK[4:])
    assert found["rms_percent"] == pytest.approx(plain["rms_percent"], rel=1e-3)
    assert "read x.mcap: /axis.drive.u in V, /axis.y in um; 3000 samples every 0.002 s (500 Hz), 6 s\n" in told


def test_cut_and_rate(csv, capsys):
    _, told = figures(capsys, csv, *QUICK, "--cut", "1:5", "--resample", "250")
    assert "1000 samples every 0.004 s (250 Hz), 4 s" in told
    _, told = figures(capsys, csv, *QUICK, "--cut", "2:")
    assert "2000 samples every 0.002 s" in told


@pytest.mark.parametrize("cut", ["5", "5:1", "a:b", "-1:3", "1:1"])
def test_a_cut_that_is_none_is_wrong_usage(csv, cut, capsys):
    assert code_of(csv, *QUICK, f"--cut={cut}") == 64
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("share", [0.002, 0.01])
def test_spikes_decide_nothing_and_are_told(share, csv, tmp_path, capsys):
    t, u, y = columns(csv)
    plain, _ = figures(capsys, csv, *QUICK)
    rng = np.random.default_rng(3)
    y[rng.choice(len(y), round(share * len(y)), replace=False)] += 500.0 * np.sign(
        rng.standard_normal(round(share * len(y)))
    )
    np.savetxt(tmp_path / "s.csv", np.column_stack([t, u, y]), "%.9g", ",", header="t_s,u_V,y_um", comments="")
    found, told = figures(capsys, tmp_path / "s.csv", *QUICK)
    assert found["rms_percent"] == pytest.approx(plain["rms_percent"], rel=0.05)
    assert f"y_um: {round(share * len(y))} samples stand out as spikes, the first at" in told


def test_a_linear_fit_with_a_gap_and_spikes_is_that_without(tmp_path, capsys):
    file = linear_record(tmp_path / "x.csv")
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    table[[50, 700, 1500], 3] += 200.0
    table = np.delete(table, [400, 401], axis=0)
    np.savetxt(tmp_path / "g.csv", table, "%.12g", ",", header="t_s,u1,u2,y1,y2", comments="")
    names = ("--input", "u1,u2", "--output", "y1,y2", "--json")
    reports = []
    for each in (file, tmp_path / "g.csv"):
        assert linear_code(each, *names) == 0
        shown = capsys.readouterr()
        reports.append(json.loads(shown.out))
    assert reports[1]["order"] == reports[0]["order"] == 3
    assert reports[1]["fit_percent"] == pytest.approx(reports[0]["fit_percent"], abs=1.0)
    assert reports[0]["strict_fit_percent"] == pytest.approx(reports[0]["fit_percent"], abs=0.5)
    assert reports[0]["arx1_strict_fit_percent"][0] < 50.0
    assert "2 samples are missing before" in shown.err
    assert "y1: 3 samples stand out as spikes" in shown.err


def test_a_bad_file_is_one_sentence_and_1(csv, tmp_path, capsys):
    content = Path(csv).read_bytes()
    (tmp_path / "half.csv").write_bytes(content[:5003])
    assert code_of(tmp_path / "half.csv", *QUICK) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "half.csv:" in said
    assert "it may be cut off" in said
