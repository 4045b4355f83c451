"""Trends: closed forms of their figures, and what their files survive."""

import asyncio
import errno
import os
import resource
import signal
import subprocess
import sys
from contextlib import closing

import numpy as np
import pytest

from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.errors import CheckFailed, ConfigError
from micromanip.host.trend.files import TrendFiles
from micromanip.host.trend.keeper import TrendKeeper
from micromanip.host.trend.summing import Summing, header
from micromanip.recordings import read_table
from micromanip.recordings.trend import MINUTE, SECOND, day_file, read_trend
from micromanip.rt.states import STATE_NAMES, STRAIN_INVALID, TRACKING
from micromanip.rt.telemetry import LINK_DOWN, ROW, TEMPERATURE_OK
from micromanip.settings.check import prepare
from tests.cells import LEISURELY, SIMULATED

NOON_S = 1_795_435_200  # 2026-11-23T12:00:00Z
PERIOD_NS = 1_000_000
AXES, WATCHED = ["x", "y"], [True, False]
HEADER = header(AXES, WATCHED)
ERROR_X = 5  # of the quantities: the first axis' last


def rows_of(seconds, begin_s=0.0, rate_hz=1e9 / PERIOD_NS):
    made = np.zeros(round(seconds * rate_hz), ROW)
    made["time_ns"] = round(begin_s * 1e9) + np.arange(len(made)) * PERIOD_NS
    made["periods"], made["state"], made["lateness_ns"] = 1, TRACKING, 4_000
    made["axis"]["fresh"] = TEMPERATURE_OK
    return made


class Cell:
    """Rows are fed by it to the files of a folder, with a clock that can be set."""

    def __init__(self, folder, clock_s=NOON_S, keep=400, quota_bytes=10**9):
        self.files = TrendFiles(folder, HEADER, {SECOND: keep, MINUTE: keep}, quota_bytes)
        self.clock_s, self.loop_s = clock_s, 0.0
        self.summing = Summing(WATCHED, PERIOD_NS, self.files.append, lambda: round(self.clock_s * 1e9))

    def run(self, seconds, batch=200, change=lambda rows, values: None):
        rows = rows_of(seconds, self.loop_s)
        values = np.zeros((len(rows), 12))
        change(rows, values)
        for at in range(0, len(rows), batch):
            self.summing.add(rows[at : at + batch], values[at : at + batch])
        self.loop_s += seconds
        return self

    def end(self):
        self.summing.end()
        self.files.close()


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("batch", [137, 200, 5000])
def test_sine_over_a_second_and_a_minute(tmp_path, batch):
    """3 sin(2 pi 5 t) + 1: rms sqrt(1 + 4.5) about zero; in a minute's other half it is not known."""

    def sine(rows, values):
        t = rows["time_ns"] * 1e-9
        values[:, ERROR_X] = np.where(t < 30, 1 + 3 * np.sin(2 * np.pi * 5 * t), np.nan)
        values[:, 3] = t  # the voltage of x: a ramp

    Cell(tmp_path).run(60, batch, sine).end()
    seconds, minutes = read_trend(tmp_path, SECOND), read_trend(tmp_path)
    assert len(seconds.time) == 60
    assert (str(seconds.time[0]), str(minutes.time[0])) == ("2026-11-23T12:00:00",) * 2
    for trend, known in ((seconds, 30), (minutes, 1)):
        expected = {"min": -2.0, "mean": 1.0, "max": 4.0, "rms": np.sqrt(5.5)}
        for each, value in expected.items():
            found = trend.columns[f"error_um_x_{each}"]
            np.testing.assert_allclose(found[:known], value, atol=3e-5)
            assert np.isnan(found[known:]).all()
    written = (tmp_path / "2026-11-23-seconds.csv").read_text()
    assert "NaN" in written
    assert "nan" not in written, "other programs take that for text"
    np.testing.assert_allclose(seconds.columns["voltage_V_x_mean"], np.arange(60) + 0.4995, rtol=1e-5)
    assert minutes.columns["voltage_V_x_max"].tolist() == [59.999]
    assert minutes.columns["voltage_V_x_rms"][0] == pytest.approx(60 / np.sqrt(3), rel=1e-4)
    assert minutes.columns["seconds"].tolist() == [60]
    assert minutes.columns["cycles"].tolist() == [60_000]
    assert minutes.columns["lateness_us_max"].tolist() == [4.0]
    assert [STATE_NAMES[int(s)] for s in minutes.columns["state"]] == ["TRACKING"]
    assert [seconds.gaps(), minutes.gaps()] == [[], []]


def test_what_is_counted(tmp_path):
    def trouble(rows, _):
        rows["fault"][1500:1700] = STRAIN_INVALID
        rows["periods"][2100] = 3
        rows["lines"][2200:2210] = LINK_DOWN
        rows["axis"]["fresh"][2999, 0] = 0

    Cell(tmp_path).run(4, change=trouble).end()
    columns = read_trend(tmp_path, SECOND).columns
    assert columns["fault"].tolist() == [0, STRAIN_INVALID, 0, 0]
    assert columns["overruns"].tolist() == [0, 0, 1, 0]
    assert columns["seconds"].tolist() == [1, 1, 1.002, 1]
    assert columns["link_down_cycles"].tolist() == [0, 0, 10, 0]
    assert columns["temperature_ok_x"].tolist() == [1, 1, 0, 1]
    assert "temperature_ok_y" not in columns
    minute = read_trend(tmp_path).columns
    assert [minute[name].tolist() for name in ("fault", "overruns", "temperature_ok_x")] == [[STRAIN_INVALID], [1], [0]]


def test_any_reader_of_tables_takes_it(tmp_path):
    Cell(tmp_path).run(3).end()
    table = read_table(tmp_path / "2026-11-23-seconds.csv")
    assert table["time"].tolist() == [0, 1, 2]
    assert table.unit("error_um_x_rms") == "um"
    assert table["cycles"].tolist() == [1000] * 3


def test_midnight(tmp_path):
    Cell(tmp_path, NOON_S + 12 * 3600 - 2.5).run(65).end()
    assert names(tmp_path) == [f"2026-11-{day}-{every}s.csv" for day in (23, 24) for every in ("minute", "second")]
    trend = read_trend(tmp_path, SECOND)
    assert trend.columns["cycles"].tolist() == [500, *[1000] * 64, 500]
    assert trend.gaps() == []
    assert str(trend.time[3]) == "2026-11-24T00:00:00"
    assert read_trend(tmp_path).columns["cycles"].tolist() == [2500, 60_000, 2500]
    only = read_trend(tmp_path, SECOND, since=np.datetime64("2026-11-24T00:00:10", "s"))
    assert (len(only.time), str(only.time[0])) == (53, "2026-11-24T00:00:10")


def test_a_clock_set_back_and_forth(tmp_path):
    """No row is lost, none counts twice; across midnight the day before goes on."""
    cell = Cell(tmp_path, NOON_S + 12 * 3600 - 5).run(10)
    cell.clock_s -= 20
    cell.run(10)
    cell.clock_s += 86_400
    cell.run(10).end()
    for every in (SECOND, MINUTE):
        trend = read_trend(tmp_path, every)
        assert trend.columns["cycles"].sum() == 30_000
        assert (np.diff(trend.time) >= np.timedelta64(0)).all()
    assert {day_file(path).day[-2:] for path in tmp_path.iterdir()} == {"23", "24", "25"}
    ((begin, end),) = read_trend(tmp_path, SECOND).gaps()[-1:]
    assert (end - begin).astype(int) > 80_000


def test_time_in_which_nothing_ran_is_a_gap(tmp_path):
    Cell(tmp_path).run(5).end()
    Cell(tmp_path, NOON_S + 600).run(5).end()
    trend = read_trend(tmp_path, SECOND)
    assert [tuple(map(str, gap)) for gap in trend.gaps()] == [("2026-11-23T12:00:05", "2026-11-23T12:10:00")]
    assert names(tmp_path) == ["2026-11-23-minutes.csv", "2026-11-23-seconds.csv"]


def test_killed_in_the_middle(tmp_path):
    """A process that is killed as it writes costs what was under way; the next goes on in the same file."""
    script = (
        "import os, pathlib, signal, tests.host.test_trend as t; "
        f"t.Cell(pathlib.Path({str(tmp_path)!r})).run(5.5); os.kill(os.getpid(), signal.SIGKILL)"
    )
    killed = subprocess.run([sys.executable, "-c", script], check=False)
    assert killed.returncode == -signal.SIGKILL
    file = tmp_path / "2026-11-23-seconds.csv"
    assert len(read_trend(file).time) == 5
    with file.open("ab") as torn:
        torn.write(b"2026-11-23T12:00:05,1,10")  # a power cut
    assert len(read_trend(file).time) == 5
    Cell(tmp_path, NOON_S + 10).run(3).end()
    assert [str(time)[-2:] for time in read_trend(file).time] == ["00", "01", "02", "03", "04", "10", "11", "12"]
    assert file.read_text().count("time") == 1


@pytest.mark.parametrize("left", [b"", b"time,sec"])
def test_killed_before_the_first_line(tmp_path, left):
    file = tmp_path / "2026-11-23-seconds.csv"
    file.write_bytes(left)
    with pytest.raises(CheckFailed, match="no second of a trend in it"):
        read_trend(file)
    Cell(tmp_path).run(2).end()
    assert len(read_trend(file).time) == 2


def test_other_columns_go_to_another_file(tmp_path):
    Cell(tmp_path).run(2).end()
    with closing(TrendFiles(tmp_path, header(["z"], [False]), {SECOND: 9, MINUTE: 9}, 10**9)) as files:
        summing = Summing([False], PERIOD_NS, files.append, lambda: (NOON_S + 60) * 10**9)
        summing.add(rows_of(2), np.ones((2000, 6)))
        summing.end()
    assert "2026-11-23-seconds-2.csv" in names(tmp_path)
    columns = read_trend(tmp_path, SECOND).columns
    np.testing.assert_array_equal(columns["error_um_z_rms"], [np.nan, np.nan, 1, 1])
    np.testing.assert_array_equal(columns["error_um_x_rms"], [0, 0, np.nan, np.nan])


def days_of(folder, every):
    return sorted({found.day for path in folder.iterdir() if (found := day_file(path)) and found.every == every})


def test_age(tmp_path):
    """The newest days stay; what is called otherwise is nobody's to remove."""
    (tmp_path / "2020-01-01-notes.csv").write_text("mine")
    (tmp_path / "2020-01-01-seconds.csv").symlink_to("2020-01-01-notes.csv")
    for day in range(5):
        Cell(tmp_path, NOON_S + day * 86_400, keep=3).run(2).end()
    for every in (SECOND, MINUTE):
        assert days_of(tmp_path, every)[-3:] == ["2026-11-25", "2026-11-26", "2026-11-27"]
        assert not {"2026-11-23", "2026-11-24"} & set(days_of(tmp_path, every))
    assert {"2020-01-01-notes.csv", "2020-01-01-seconds.csv"} <= set(names(tmp_path))


def test_quota_takes_seconds_first_and_never_today(tmp_path):
    for day in range(4):
        Cell(tmp_path, NOON_S + day * 86_400).run(5).end()
    size = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    minutes = sum(bytes_ for name, bytes_ in size.items() if "minutes" in name)
    Cell(tmp_path, NOON_S + 3 * 86_400 + 60, quota_bytes=minutes + 2 * size["2026-11-23-seconds.csv"]).run(1).end()
    assert days_of(tmp_path, SECOND) == ["2026-11-26"]
    assert len(days_of(tmp_path, MINUTE)) == 4
    Cell(tmp_path, NOON_S + 3 * 86_400 + 120, quota_bytes=1).run(1).end()
    assert (days_of(tmp_path, SECOND), days_of(tmp_path, MINUTE)) == (["2026-11-26"], ["2026-11-26"])


def test_quota_spares_todays_minutes_at_a_start(tmp_path):
    Cell(tmp_path).run(130).end()
    cell = Cell(tmp_path, NOON_S + 200, quota_bytes=1).run(1.5)
    assert len(read_trend(tmp_path).time) == 3
    cell.end()


def test_full_disk_leaves_the_file_as_it_was(tmp_path):
    script = f"""
import pathlib, resource, tests.host.test_trend as t
cell = t.Cell(pathlib.Path({str(tmp_path)!r})).run(3.5)
size = pathlib.Path({str(tmp_path / "2026-11-23-seconds.csv")!r}).stat().st_size
resource.setrlimit(resource.RLIMIT_FSIZE, (size + 50, size + 50))
try:
    cell.run(3)
except OSError as problem:
    raise SystemExit(problem.errno)
"""
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == errno.EFBIG
    content = (tmp_path / "2026-11-23-seconds.csv").read_bytes()
    assert content.endswith(b"\n")
    assert content.count(b"\n") == 4


def test_two_controllers_do_not_mix(tmp_path):
    cell = Cell(tmp_path)
    with pytest.raises(OSError, match="another controller keeps its trend there"):
        Cell(tmp_path)
    cell.end()
    Cell(tmp_path).end()


@pytest.mark.parametrize("obstacle", ["file", "other"])
def test_a_folder_that_is_refused_is_told_once(tmp_path, obstacle):
    """Also in the end, where the first line came too late to be told of before."""
    file, folder = tmp_path / "cell.yaml", tmp_path / "kept"
    file.write_text(f"{SIMULATED.read_text()}\ntrend: {{folder: kept}}\n")
    other = Cell(folder) if obstacle == "other" else folder.write_text("in the way")
    prepared, said = prepare(file), []
    keeper = TrendKeeper(prepared, prepared.configuration.trend, said.append)
    quantities = np.zeros((3000, len(prepared.configuration.axes) * 6))
    keeper.add(rows_of(3), quantities)
    asyncio.run(keeper.end())
    keeper.add(rows_of(3, 3), quantities)
    (warning,) = said
    assert warning.startswith(f"WARNING: {folder}: ")
    assert ("another controller keeps its trend there" in warning) == (obstacle == "other")
    assert warning.endswith("no trend is kept any more until the next start")
    if obstacle == "other":
        other.end()


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("trend: {keep_days: 0}", r"trend\.keep_days"),
        ("trend: {quota_MB: much}", r"trend\.quota_MB"),
        ("trend: {keep_day: 3}", r"keep_day\b.*did you mean keep_days"),
        ("trend: {folder: ''}", r"trend\.folder"),
        ("trend: on", "trend"),
    ],
)
def test_bad_keys(tmp_path, written, said):
    file = tmp_path / "cell.yaml"
    file.write_text(f"{SIMULATED.read_text()}\n{written}\n")
    with pytest.raises(ConfigError, match=said) as refused:
        prepare(file)
    assert f"{file}:{len(file.read_text().splitlines())}" in str(refused.value)


def test_no_rows_are_no_line(tmp_path):
    cell = Cell(tmp_path)
    cell.summing.add(np.zeros(0, ROW), np.zeros((0, 12)))
    cell.end()
    assert names(tmp_path) == []


def test_a_running_cell_keeps_a_trend_until_the_disk_is_full(run):
    """Rows come as it runs; then the disk takes no more, which is told once, and the cell tracks on."""
    cell = run(LEISURELY + "trend: {folder: kept}\n").reach("TRACKING")
    folder = cell.config.parent / "kept"

    def lines():
        return sum(path.read_bytes().count(b"\n") for path in folder.glob("*-seconds*.csv"))

    until(lambda: folder.is_dir() and lines() > 3, cell.last_words)
    trend = read_trend(folder, SECOND)
    assert trend.columns["cycles"].max() <= 202
    assert np.isfinite(trend.columns["voltage_V_x_rms"]).all()
    size = max(path.stat().st_size for path in folder.iterdir()) + 700  # what it says goes to a file, too
    resource.prlimit(cell.process.pid, resource.RLIMIT_FSIZE, (size, size))
    until(lambda: "no trend is kept any more" in cell.said, cell.last_words)
    cell.go_on(400)
    assert cell.state == "TRACKING"
    with Client(cell.socket) as client:
        told = client.status()
    assert told["axes"]["x"]["voltage_V"]["latest"] is not None
    assert told["trend"]["folder"] == str(folder)
    assert np.datetime64(told["trend"]["newest"]) >= trend.time[-1]
    assert told["trend"]["age_s"] >= 0.0
    assert "make room there" in told["trend"]["message"]
    assert cell.end() == 0
    assert cell.said.count("no trend is kept any more") == 1
    assert f"{os.strerror(errno.EFBIG)}; make room there" in cell.said
