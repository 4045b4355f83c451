"""``fit linear``: the documented keys, CSV by name and text by number, several files; errors in one line."""

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

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


def spoilt(file, change):
    """The record with its columns changed."""
    names = ["t_s", "u1", "u2", "y1", "y2"]
    table = dict(zip(names, np.loadtxt(file, delimiter=",", skiprows=1).T.copy(), strict=True))
    change(table)
    np.savetxt(file, np.column_stack(list(table.values())), "%.12g", ",", header=",".join(table), comments="")


def test_a_clipped_output_is_told_of(csv, capsys):
    assert report_of(capsys, csv, *COLUMNS)["notes"] == []
    spoilt(csv, lambda table: np.minimum(table["y2"], np.quantile(table["y2"], 0.9), out=table["y2"]))
    (note,) = report_of(capsys, csv, *COLUMNS)["notes"]
    assert re.match(r"y2 sticks at its top value [\d.]+ for 10 % of the samples while the input moves: where the", note)


@pytest.mark.parametrize("order", [(), ("--order", "3")])
def test_columns_that_are_mixed_up_are_refused(order, csv, capsys):
    assert code_of(csv, "--input", "y1", "--output", "u1", *order) == 1
    said = capsys.readouterr().err
    assert re.search(r"u1 runs ahead of y1: from y1 to u1 a model fits with \d %, the other way round with 9\d", said)
    assert code_of(csv, "--input", "u1", "--output", "y1", *order) == 0


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
    assert report["figures"] == []
    assert min(report["coherence"]) > 0.8
    A, B, C, K = (np.array(report[name]) for name in "ABCK")
    assert (A.shape, B.shape, C.shape, K.shape) == ((6, 6), (6, 2), (2, 6), (6, 2))
    gain = C @ np.linalg.solve(np.eye(6) - A, B)
    truth = [[0.3 / np.polyval(np.poly(POLES).real, 1.0), 0.0], [1.0, 2.0]]
    assert gain == pytest.approx(np.array(truth), abs=0.05)


def test_text_without_header_by_number(tmp_path, capsys):
    u, y = signals()
    for separator in (" ", ","):
        file = tmp_path / "x.dat"
        np.savetxt(file, np.column_stack([u, y]), "%.12e", separator)
        report = report_of(capsys, file, "--input", "1,2", "--output", "3, 4", "--dt", DT)
        assert (report["order"], report["delay_samples"]) == (3, [3, 0])


def test_given_order_and_split(csv, capsys):
    low, short = (report_of(capsys, csv, *COLUMNS, *more) for more in (("--order", 1), ("--order", 3, "--split", 0.2)))
    assert low["order"] == 1
    assert list(low["tried"]) == ["1"]
    assert max(low["fit_percent"]) < 98.0
    assert min(short["fit_percent"]) > 98.0


def test_several_files_are_several_experiments(tmp_path, capsys):
    files = [record(tmp_path / f"{seed}.csv", seed, samples=400, noise=0.2) for seed in range(4)]
    other = record(tmp_path / "other.csv", 9, noise=0.0)
    both = [
        report_of(capsys, *chosen, *COLUMNS, "--order", 3, "--split", 1, "--validate", other)
        for chosen in (files[:1], files)
    ]
    assert both[0]["fit_percent"] == both[0]["validation"]["fit_percent"]
    assert np.mean(both[1]["rms_error_percent"]) < 0.8 * np.mean(both[0]["rms_error_percent"])


def test_validation_is_judged_apart(csv, tmp_path, capsys):
    other = record(tmp_path / "other.csv", 2, noise=0.1)
    report = report_of(capsys, csv, *COLUMNS, "--validate", other)
    assert report["fit_percent"] == pytest.approx([99.0, 99.0], abs=0.3)
    assert report["validation"]["fit_percent"] == pytest.approx([90.0, 90.0], abs=1.5)
    assert report["validation"]["rms_error_percent"] == pytest.approx([10.0, 10.0], abs=1.5)


def test_a_whole_multiple_of_the_sampling_interval_thins(tmp_path, capsys):
    """A slow lag sampled fast, and the same modelled at a quarter of the rate."""
    rng = np.random.default_rng(0)
    u = lfilter([0.02], [1.0, -0.98], rng.normal(size=8000))
    y = lfilter([0.0, 0.01], [1.0, -0.99], u)
    file = tmp_path / "slow.csv"
    np.savetxt(file, np.column_stack([DT * np.arange(8000), u, y]), "%.12g", ",", header="time,u,y", comments="")
    report = report_of(capsys, file, "--input", "u", "--output", "y", "--dt", 4 * DT, "--order", 1)
    assert report["dt_s"] == pytest.approx(4 * DT)
    assert report["poles_z"][0][0] == pytest.approx(0.99**4, abs=0.01)
    assert code_of(file, "--input", "u", "--output", "y", "--dt", 3.5 * DT) == 1
    said = capsys.readouterr().err
    assert "slow.csv: --dt 0.007 s is no whole multiple of the record's sampling interval, 0.002 s" in said


@pytest.mark.long
def test_text_and_figures(csv, tmp_path, capsys):
    out = tmp_path / "out"
    assert code_of(csv, *COLUMNS, "--out", out) == 0
    said = capsys.readouterr().out
    assert said.startswith("order 3, delay 3, 0 samples of 0.002 s\n")
    assert re.search(r"^held out, y1: fit 9[89]\.\d\d %, rms error [01]\.\d\d %$", said, re.MULTILINE)
    assert re.search(r"^  pole 0\.\d+ \+0\.\d+j: 24\.\d+ Hz, damping 0\.16\d+$", said, re.MULTILINE)
    assert re.search(r"^  tried order 1: \d+\.\d+ % on the part left out$", said, re.MULTILINE)
    names = ["singular_values", "free_run", *(f"bode_u{i}_y{o}" for i in (1, 2) for o in (1, 2))]
    assert {path.name for path in out.iterdir()} == {f"{name}.svg" for name in names}
    assert f"12 figures in {out}/" in said


def constant_input(table):
    table["u2"][:] = 3.0


def constant_output(table):
    table["y1"][:] = 3.0


def not_a_number(table):
    table["y2"][[40, 50]] = np.nan


def too_short(table):
    for name in table:
        table[name] = table[name][:150]


def hardly_long_enough(table):
    for name in table:
        table[name] = table[name][:200]


def still_later(table):
    table["u1"][1000:] = 0.0


def copied(table):
    table["u2"] = 2.0 * table["u1"] + 1.0


def no_time(table):
    del table["t_s"]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (constant_input, "u2 is constant: record while"),
        (constant_output, "y1 is constant: record while"),
        (not_a_number, r"x.csv:42: y2 has no number here \(2 in all\)"),
        (too_short, "150 samples are too few; record at least 200"),
        (hardly_long_enough, "an experiment of 100 samples is too short; at least"),
        (still_later, "split at 0.5, u1 stands still in the last 1000 samples"),
        (copied, "the inputs u1, u2 move together"),
        (no_time, "there is no time column"),
    ],
)
def test_bad_data_is_one_sentence_and_1(csv, tmp_path, change, sentence, capsys):
    spoilt(csv, change)
    order = ("--order", 20) if change is hardly_long_enough else ()
    assert code_of(csv, *COLUMNS, *order, "--out", tmp_path / "out") == 1
    said = capsys.readouterr().err
    assert re.search(sentence, said)
    assert said.count("micromanip: ") == 1
    assert "Traceback" not in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--input", "u3", "--output", "y1"), "there is no column u3; its columns are t_s, u1, u2, y1, y2"),
        (("--input", "u1", "--output", "9"), "there is no column 9; its columns are t_s, u1, u2, y1, y2"),
    ],
)
def test_unknown_column(csv, arguments, sentence, capsys):
    assert code_of(csv, *arguments) == 1
    assert sentence in capsys.readouterr().err


def test_other_rate_and_missing_file_are_named(csv, tmp_path, capsys):
    other = record(tmp_path / "other.csv", 2, 2 * DT)
    assert code_of(csv, other, *COLUMNS) == 1
    assert f"{other}: sampled every 0.004 s, {csv} every 0.002 s; record all at one rate" in capsys.readouterr().err
    assert code_of(csv, *COLUMNS, "--validate", tmp_path / "none.csv") == 1
    assert capsys.readouterr().err == f"micromanip: {tmp_path / 'none.csv'}: no such file\n"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--input", "u1", "--output", "u1"), "the column u1 can't be input and output"),
        (("--input", "u1,,u2", "--output", "y1"), "--input u1,,u2: name each column once"),
        (("--input", "u1,u1", "--output", "y1"), "--input u1,u1: name each column once"),
        ((*COLUMNS, "--split", "1"), "--split 1 leaves nothing to judge the model by"),
        ((*COLUMNS, "--split", "0"), "from 0.1 to 1"),
        ((*COLUMNS, "--order", "0"), "1<=x<=60"),
        (("--input", "u1"), "--output"),
    ],
)
def test_wrong_usage_is_64(csv, arguments, sentence, capsys):
    assert code_of(csv, *arguments) == 64
    assert sentence in capsys.readouterr().err


def test_help_says_how_columns_are_numbered(capsys):
    assert code_of("--help") == 0
    said = capsys.readouterr().out
    assert "numbers from 1" in " ".join(said.split())


def test_a_file_that_is_no_table(tmp_path, capsys):
    file = tmp_path / "x.csv"
    file.write_bytes(Path(__file__).read_bytes())
    assert code_of(file, *COLUMNS) == 1
    assert capsys.readouterr().err.startswith(f"micromanip: {file}")
