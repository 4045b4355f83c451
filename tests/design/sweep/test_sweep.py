"""Drawn tunings: what is drawn, that results follow from their number alone whoever dies, what the command says."""

import csv
import json
import pickle
import sqlite3

import numpy as np
import pytest
import yaml
from cli.command import code_of
from hypothesis import given
from hypothesis import strategies as st

from campaigns.counterfactual import record, recorded_cell, track
from micromanip.design.sweep import running
from micromanip.design.sweep.sharing import on_cluster, on_processes
from micromanip.design.sweep.space import Dimension, Space, for_axes, read_dimensions
from micromanip.design.sweep.store import Store
from micromanip.design.sweep.work import Work
from micromanip.errors import ConfigError, DeviceUnavailable, UsageError

from .mortal import Mortal, tried

KEYS, AXES = ["a.b", "c"], ["x", "y"]
ABOUT = {"seed": 1}


@given(st.integers(0, 2**32 - 1), st.integers(1, 10**7))
def test_values_lie_between_the_ends_and_follow_from_the_number(seed, number):
    space = Space((Dimension("k", 2.0, 200.0, log=True), Dimension("m", -1.0, 1.0)), seed)
    values = space.values(number)
    assert 2.0 <= values["k"] <= 200.0
    assert -1.0 <= values["m"] <= 1.0
    assert values == Space(space.dimensions, seed).values(number) != space.values(number + 1)


def test_a_logarithm_is_drawn_evenly_over_it():
    space = Space((Dimension.parse("k=1:100:log"), Dimension.parse("m=0:8")), 3)
    drawn = [space.values(number) for number in range(1, 2001)]
    assert np.mean([each["k"] < 10.0 for each in drawn]) == pytest.approx(0.5, abs=0.04)
    assert np.mean([each["m"] for each in drawn]) == pytest.approx(4.0, abs=0.2)
    assert space.values(0) == {}


@pytest.mark.parametrize("text", ["k", "k=1", "k=2:1", "k=1:x", "=1:2", "k=1:2:lin", "k=nan:2", "k=1:inf", "k=0:1:log"])
def test_what_is_no_range_is_refused(text):
    with pytest.raises(UsageError, match=f"--vary '{text}'"):
        Dimension.parse(text)


def test_every_axis_alike():
    assert for_axes({"axes.*.inner.Ti_ms": 1.0, "reference.noise_um": 2.0}, AXES) == {
        "axes.x.inner.Ti_ms": 1.0,
        "axes.y.inner.Ti_ms": 1.0,
        "reference.noise_um": 2.0,
    }


def test_what_is_kept_is_read_again(tmp_path):
    with Store(tmp_path / "s.sqlite", ABOUT, KEYS, AXES) as store:
        store.add(tried(number) for number in range(20) if number != 4)
        assert store.missing(21) == [4, 20, 21]
        assert [store.one(number) for number in (0, 3, 5, 6)] == [tried(number) for number in (0, 3, 5, 6)]
        good = sorted((t for n in range(20) if n != 4 and (t := tried(n)).cost_um is not None), key=lambda t: t.cost_um)
        assert store.best(3) == good[:3]
        assert store.counts() == {"tried": 19, "refused": 2, "stopped": 3}
    with pytest.raises(UsageError, match=r"holds another sweep: its seed is 1, not 2; give another name"):
        Store(tmp_path / "s.sqlite", {"seed": 2}, KEYS, AXES)
    (tmp_path / "text").write_text("no database, but longer than the header of one, which has a hundred bytes" * 3)
    with pytest.raises(UsageError, match="text is no file of a sweep"):
        Store(tmp_path / "text", ABOUT, KEYS, AXES)
    with pytest.raises(DeviceUnavailable):
        Store(tmp_path / "nowhere" / "s.sqlite", ABOUT, KEYS, AXES)


def test_a_space_in_a_file_is_that_of_the_options(tmp_path):
    file = tmp_path / "space.yaml"
    file.write_text("vary:\n  axes.*.outer.control_weight: {low: 1, high: 100, log: true}\n  m: {low: -1, high: 1}\n")
    found = read_dimensions(file)
    assert found == (Dimension.parse("axes.*.outer.control_weight=1:100:log"), Dimension.parse("m=-1:1"))
    assert [each.origin for each in found] == [f"{file}:2:", f"{file}:3:"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("varry: {m: {low: 0, high: 1}}", ":1: varry: .*did you mean vary"),
        ("vary:\n  m: {low: 0, hihg: 1}", ":2: vary.m.hihg: .*did you mean high"),
        ("vary:\n  m:\n    low: 1\n    high: 0", ":4: vary.m.high: must be above low, 1"),
        ("vary: {m: {low: 0, high: 1, log: true}}", ":1: vary.m.low: a logarithm begins above 0"),
        ("vary: {}", ":1: vary: "),
    ],
)
def test_what_is_wrong_in_a_space_is_told_with_its_line(tmp_path, text, says):
    file = tmp_path / "space.yaml"
    file.write_text(text + "\n")
    with pytest.raises(ConfigError, match=says):
        read_dimensions(file)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_results_as_a_table(tmp_path, ending):
    with Store(tmp_path / "s.sqlite", ABOUT, KEYS, AXES) as store:
        store.add(tried(number) for number in range(20))
        file = tmp_path / f"t.{ending}"
        store.write_table(file)
    if ending == "parquet":
        rows = [tuple(row.values()) for row in pytest.importorskip("pyarrow.parquet").read_table(file).to_pylist()]
        assert rows == results(tmp_path / "s.sqlite")
        return
    head, *rows = csv.reader(file.read_text().splitlines())
    assert head[:6] == ["number", "cost_um", "stopped", "problem", "a.b", "c"]
    assert rows == [["" if each is None else str(each) for each in row] for row in results(tmp_path / "s.sqlite")]


def results(file):
    with sqlite3.connect(file) as database:
        return database.execute("SELECT * FROM tunings ORDER BY number").fetchall()


@pytest.mark.live
def test_a_killed_worker_changes_no_result(tmp_path, monkeypatch):
    monkeypatch.setattr(running, "BATCH", 3)
    content, told = pickle.dumps(Mortal(tmp_path)), []
    for name, fatal in (("calm", ()), ("killed", (7,))):
        for number in fatal:
            (tmp_path / str(number)).touch()
        with Store(tmp_path / name, ABOUT, KEYS, AXES) as store:
            jobs = 2 if fatal else 1
            running.run_trials(store, Work(name, content=content), 30, on_processes(jobs), told.append)
        assert not [number for number in fatal if (tmp_path / str(number)).exists()], "no worker was killed"
    assert len(results(tmp_path / "calm")) == 31
    assert results(tmp_path / "killed") == results(tmp_path / "calm")
    assert sum(told) == 2 * 31


@pytest.mark.filterwarnings("ignore")  # a worker that is killed closes nothing
@pytest.mark.parametrize(
    "fatal", [(), pytest.param((7, 20), marks=pytest.mark.thorough)], ids=["calm", "killed"]
)  # fmt: skip
def test_a_cluster_gives_the_same_results(tmp_path, monkeypatch, fatal):
    """On a scheduler's workers, which are processes where they are killed: one for each number of `fatal`."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(running, "BATCH", 3)
    work = Work(f"{tmp_path}", content=pickle.dumps(Mortal(tmp_path)))
    for number in fatal:
        (tmp_path / str(number)).touch()
    local = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=bool(fatal), dashboard_address=None, host="127.0.0.1",
        protocol="tcp",
    )  # fmt: skip
    with local, Store(tmp_path / "there", ABOUT, KEYS, AXES) as store:
        running.run_trials(store, work, 30, on_cluster(local.scheduler_address))
    assert not [number for number in fatal if (tmp_path / str(number)).exists()], "no worker was killed"
    with Store(tmp_path / "here", ABOUT, KEYS, AXES) as store:
        store.add(tried(number) for number in range(31))
    assert results(tmp_path / "there") == results(tmp_path / "here")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    cell = recorded_cell()
    file = tmp_path_factory.mktemp("sweep") / "run.mcap"
    record(cell, track(cell, cell.parameters)[: -5 * 2000], file)
    return file


@pytest.mark.compiled_only
@pytest.mark.long
def test_the_command(recording, tmp_path, capsys):
    def swept(name, number, *more):
        options = ("--cut", "5.5:6.2", "--jobs", 1, "--out", tmp_path / name, "--number", number)
        varied = ("--vary", "axes.*.outer.control_weight=0.5:50:log", "--vary", "axes.x.inner.K_V_per_um=0.1:2")
        return code_of("sweep", recording, *varied, *options, *more)

    assert swept("s.sqlite", 3, "--json") == 0
    first = json.loads(capsys.readouterr().out)
    assert first["tried"] == 4
    assert swept("s.sqlite", 9, "--json", "--best", tmp_path / "best.yaml", "--top", 20) == 0
    more = json.loads(capsys.readouterr().out)
    assert swept("again.sqlite", 9, "--table", tmp_path / "all.csv") == 0
    assert len((tmp_path / "all.csv").read_text().splitlines()) == 11
    printed = capsys.readouterr().out
    assert results(tmp_path / "again.sqlite") == results(tmp_path / "s.sqlite")
    assert f"{more['tried']} tried, {more['refused']} refused, {more['stopped']} would stop the cell" in printed

    costs = [each["cost_um"] for each in more["best"]]
    assert costs == sorted(costs)
    assert more["base"]["values"] == {}
    assert [each["number"] for each in more["best"] if each["problem"]], "a gain of 1.5 V/um passes no check"
    best = next(each for each in more["best"] if not each["problem"])
    fragment = (tmp_path / "best.yaml").read_text()
    assert fragment.startswith("# A part of a configuration, no whole one: tuning")
    assert f"{best['cost_um']:.4f} um rms" in fragment
    written = yaml.safe_load(fragment)["axes"]
    assert written["z"] == {"outer": {"control_weight": best["values"]["axes.*.outer.control_weight"]}}

    assert swept("s.sqlite", 3, "--seed", 2) == 64
    assert "holds another sweep: its seed is 1, not 2" in capsys.readouterr().err

    space = tmp_path / "space.yaml"
    space.write_text("vary:\n  axes.x.inner.Tii_ms: {low: 1, high: 2}\n")
    assert code_of("sweep", recording, "--space", space, "--out", tmp_path / "none.sqlite") == 64
    said = capsys.readouterr().err
    assert f"{space}:2: axes.x.inner.Tii_ms: there is no Tii_ms; did you mean Ti_ms?" in said
    assert code_of("sweep", recording, "--out", tmp_path / "none.sqlite") == 64
    (tmp_path / "text").write_text("{}")
    assert code_of("sweep", recording, "--vary", "axes.x.inner.K_V_per_um=.4:.8", "--out", tmp_path / "text") == 64
    assert (tmp_path / "text").read_text() == "{}"
    assert "nothing is varied: give --vary KEY=LOW:HIGH, or --space FILE.yaml" in capsys.readouterr().err


@pytest.mark.compiled_only
@pytest.mark.long
@pytest.mark.parametrize(
    ("given", "code", "says"),
    [
        (
            ("--vary", "axes.x.inner.Tii_ms=1:2"),
            64,
            "--vary axes.x.inner.Tii_ms: there is no Tii_ms; did you mean Ti_ms?",
        ),
        (("--vary", "axes.x.mode=1:2"), 64, "it is stage, and no number to be drawn"),
        (("--vary", "loop.rate_hz=9000:10000"), 64, "only axes and reference are a tuning"),
        (("--vary", "axes.x.inner.Ti_ms=1:2", "--vary", "axes.x.inner.Ti_ms=1:3"), 64, "is given twice"),
        (("--vary", "axes.x.inner.Ti_ms=1:2", "--cut", "0:1"), 1, "no piece of 0.5 s tracks in it from 0 to 1 s"),
    ],
)
def test_what_cannot_be_swept_is_one_message(recording, tmp_path, capsys, given, code, says):
    assert code_of("sweep", recording, *given, "--out", tmp_path / "s.sqlite", "--jobs", 1) == code
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("micromanip: ")]
    assert says in line
    assert not (tmp_path / "s.sqlite").exists()
