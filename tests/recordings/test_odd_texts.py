"""Texts as testers, loggers and exporters leave them: read, with what is left out said by its lines, or refused."""

import datetime

import numpy as np
import pytest

from micromanip.errors import CheckFailed
from micromanip.recordings import Wanted, take

from .signals import SAMPLES, STEP_S, T, U, Y, lines
from .test_text import same, split, written


def block(number, settings):
    return [f"Table {number}", *(f"Setting {k}: {k}" for k in range(settings)), "t_s\tCh1 [V]\ty_um [um]", *lines("\t")]


@pytest.mark.parametrize("settings", [0, 20, 62, 500])
def test_a_second_table_is_told_whatever_stands_between(settings, tmp_path):
    file = written(tmp_path / "x.txt", "\n".join(block(1, settings) + block(2, settings) + block(3, settings)))
    header, last = 2 * (settings + 2) + SAMPLES, settings + 2 + SAMPLES
    with pytest.raises(CheckFailed) as raised:
        take(file, Wanted(("Ch1", "y_um")))
    assert f"x.txt:{header}: a second table begins here" in str(raised.value)
    assert f"there are 3, in lines {settings + 3} to {last}, {header + 1} to {header + SAMPLES}," in str(raised.value)


def test_a_table_of_other_columns_before_is_told(tmp_path):
    wide = ["a,b,c,d", *(",".join(["1.5"] * 4) for _ in range(30))]
    file = written(tmp_path / "x.csv", "\n".join([*wide, "t,u,y", *lines()]))
    with pytest.raises(CheckFailed, match=r"x.csv:32: a second table begins here.* lines 2 to 31, 33 to 632"):
        take(file, Wanted(("u", "y")))


def test_settings_with_names_of_their_own_and_names_with_digits(tmp_path):
    head = ["R [Ohm]\tC [pF]\tTemp [C]", "0000000000\t0000100000\t+025.00", "Time [s]\tCh1 [V]\tCh2 [um]"]
    taken = same(written(tmp_path / "x.txt", "\n".join([*head, *lines("\t")])), ("Ch1 [V]", "Ch2 [um]"))
    assert taken.notes == ["line 2: numbers before the table, left out as settings"]


def test_what_is_said_behind_a_table_is_left_out_with_its_lines(tmp_path):
    taken = same(written(tmp_path / "x.csv", "\n".join(["t,u,y", *lines(), "", "Mean,50,55", "End of file"])))
    assert taken.notes == ["line 603 to 604: no rows, behind the table, left out"]


@pytest.mark.parametrize("often", [3, None], ids=["evenly", "at random"])
def test_rows_that_repeat_the_one_before_are_left_out(often, tmp_path):
    rng = np.random.default_rng(0)
    times = [often or int(rng.integers(3, 6)) for _ in T]
    file = written(
        tmp_path / "x.csv", "t,u,y\n" + "\n".join(r for r, n in zip(lines(), times, strict=True) for _ in range(n))
    )
    told = f"{sum(times) - SAMPLES} rows repeat the one before and are left out, the first at {file}:3"
    assert same(file).notes == [told]


def test_a_clock_that_stands_while_the_signals_move_is_refused_with_a_way_out(tmp_path):
    still = "\n".join(f"{0.02 * (k // 2 * 2 + k % 3)},{u},{y}" for k, (u, y) in enumerate(zip(U, Y, strict=True)))
    file = written(tmp_path / "x.csv", "t,u,y\n" + still)
    with pytest.raises(CheckFailed, match=r"x.csv:\d+: t (falls|stands).* of 599 steps do not rise.* --time none --dt"):
        take(file, Wanted(("u", "y")))
    same(file, time="none", step_s=STEP_S)


def test_rows_that_lack_a_number_are_left_out(tmp_path):
    """Two topics merged by time; ten rows are the other's, an eleventh has a time only."""
    rows = lines()
    for k in range(550, -1, -50):
        rows.insert(k + 1, f"{T[k] + 0.3 * STEP_S:.6f},," + ("nan" if k else ""))
    taken = same(
        written(tmp_path / "x.csv", "__time,/amp/u_V,/gauge/y_um\n" + "\n".join(rows)), ("/amp/u_V", "/gauge/y_um")
    )
    assert taken.notes == [f"12 rows lack a number and are left out, the first at {tmp_path}/x.csv:3"]


def test_a_column_that_ends_earlier_is_a_column(tmp_path):
    rows = [f"{t},{u},{y if k < 500 else ''}" for k, (t, u, y) in enumerate(map(split, lines()))]
    taken = take(written(tmp_path / "x.csv", "t,u,y\n" + "\n".join(rows)), Wanted(("u", "y")))
    assert taken.notes == [f"100 rows lack a number and are left out, the first at {tmp_path}/x.csv:502"]


def test_columns_that_were_logged_apart_are_brought_together_at_a_rate(tmp_path):
    rows = [f"{t},{u}," if k % 2 else f"{t},,{y}" for k, (t, u, y) in enumerate(map(split, lines()))]
    file = written(tmp_path / "x.csv", "t,u,y\n" + "\n".join(rows))
    with pytest.raises(CheckFailed, match=r"of 600 rows 0 have all numbers \(u in 300, y in 300\).* --resample HZ"):
        take(file, Wanted(("u", "y")))
    taken = take(file, Wanted(("u", "y"), rate_hz=100.0))
    assert "logged apart" in taken.notes[0]
    at = T[1] + taken.index * 0.01
    assert np.abs(taken.values[10:-10, 1] - np.interp(at, T, Y)[10:-10]).max() < 0.1


@pytest.mark.parametrize(
    "name", ["__time", "sampling_time", "Sampling Time", "Time(S)", "TIME [Sec]", "samplingTime", "elapsed"]
)
def test_a_column_of_time_of_any_name(name, tmp_path):
    """Behind a column that begins with t and falls."""
    rows = [f"{u},{t},{u},{y}" for t, u, y in map(split, lines())]
    same(written(tmp_path / "x.csv", f"torque,{name},u,y\n" + "\n".join(rows)))


def test_times_in_milliseconds_by_their_name(tmp_path):
    rows = [f"{round(1e3 * float(t))},{u},{y}" for t, u, y in map(split, lines())]
    same(written(tmp_path / "x.csv", "millis,u,y\n" + "\n".join(rows)))


@pytest.mark.parametrize(("first", "step_s", "percent"), [(0, 0.001, 0.02), (500, 0.001, 0.01), (300, 0.004, 0.05)])
def test_stamps_of_whole_seconds_tell_the_rate_by_their_rows(first, step_s, percent, tmp_path):
    begin = datetime.datetime(2026, 2, 12, 16, 56, 8, tzinfo=datetime.UTC)
    x = np.sin(np.arange(8000))
    when = [begin + datetime.timedelta(milliseconds=round(1e3 * step_s) * k + first) for k in range(len(x))]
    file = written(
        tmp_path / "x.csv",
        "when,u,y\n" + "\n".join(f"{w:%Y-%m-%d %H:%M:%S},{v},{v}" for w, v in zip(when, x, strict=True)),
    )
    taken = take(file, Wanted(("u", "y")))
    assert taken.step_s == pytest.approx(step_s, rel=1e-9)
    assert f"every {step_s:g} s, known to " in taken.notes[0]
    assert float(taken.notes[0].split()[-2]) <= percent


def test_too_few_stamps_to_tell_a_rate_are_refused(tmp_path):
    rows = [f"{float(t) // 1.0},{u},{y}" for t, u, y in map(split, lines()[:300])]
    file = written(tmp_path / "x.csv", "t,u,y\n" + "\n".join(rows))
    with pytest.raises(CheckFailed, match=r"t is rounded to 1 s, and too few .* rate of 300 samples: give it"):
        take(file, Wanted(("u", "y")))
    assert take(file, Wanted(("u", "y"), step_s=STEP_S)).step_s == STEP_S
