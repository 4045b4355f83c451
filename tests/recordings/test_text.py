"""Texts as spreadsheets, oscilloscopes, LabVIEW and simulators write them: the same numbers come out of each."""

import datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micromanip.errors import CheckFailed, UsageError
from micromanip.recordings import Wanted, read_table, take
from tests.recordings.signals import SAMPLES, STEP_S, T, U, Y, lines


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
    assert taken.notes == ("line 2: numbers before the table, left out as settings",)


def test_what_is_said_behind_a_table_is_left_out_with_its_lines(tmp_path):
    taken = same(written(tmp_path / "x.csv", "\n".join(["t,u,y", *lines(), "", "Mean,50,55", "End of file"])))
    assert taken.notes == ("line 603 to 604: no rows, behind the table, left out",)


def test_a_table_with_the_newest_row_first_is_turned_round(tmp_path):
    taken = same(written(tmp_path / "x.csv", "\n".join(["t,u,y", *lines()[::-1]])))
    assert taken.notes == ("t falls with every row: the newest stands first, read from the last on",)


@pytest.mark.parametrize("often", [3, None], ids=["evenly", "at random"])
def test_rows_that_repeat_the_one_before_are_left_out(often, tmp_path):
    rng = np.random.default_rng(0)
    times = [often or int(rng.integers(3, 6)) for _ in T]
    rows = (row for row, count in zip(lines(), times, strict=True) for _ in range(count))
    file = written(tmp_path / "x.csv", "t,u,y\n" + "\n".join(rows))
    told = f"{sum(times) - SAMPLES} rows repeat the one before and are left out, the first at {file}:3"
    assert same(file).notes == (told,)


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
    file = written(tmp_path / "x.csv", "__time,/amp/u_V,/gauge/y_um\n" + "\n".join(rows))
    taken = same(file, ("/amp/u_V", "/gauge/y_um"))
    assert taken.notes == (f"12 rows lack a number and are left out, the first at {tmp_path}/x.csv:3",)


def test_a_column_that_ends_earlier_is_a_column(tmp_path):
    rows = [f"{t},{u},{y if k < 500 else ''}" for k, (t, u, y) in enumerate(map(split, lines()))]
    taken = take(written(tmp_path / "x.csv", "t,u,y\n" + "\n".join(rows)), Wanted(("u", "y")))
    assert taken.notes == (f"100 rows lack a number and are left out, the first at {tmp_path}/x.csv:502",)


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


LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t,
Multi_Headings\tNo
X_Columns\tOne
Time_Pref\tRelative
Operator\tlab
Date\t2024/03/01
Time\t10:11:12,5000000000000000000
***End_of_Header***\t
\t
Channels\t2\t\t
Samples\t600\t600\t
Date\t2024/03/01\t2024/03/01\t
Y_Unit_Label\tVolts\tum\t
X_Dimension\tTime\tTime\t
X0\t0,0000000000000000E+0\t0,0000000000000000E+0\t
Delta_X\t0,005000\t0,005000\t
***End_of_Header***\t\t\t
X_Value\tAmplifier\tGauge\tComment
"""
TEKTRONIX = """Model,MSO24
Firmware Version,2.0.3.950

Waveform Type,ANALOG,
Point Format,Y,
Horizontal Units,s,
Horizontal Scale,0.4,
Horizontal Delay,0,
Sample Interval,0.005,
Record Length,600,
Gating,0.0% to 100.0%,
Probe Attenuation,1,1
Vertical Units,V,V
Vertical Offset,0,0
Labels,amp,gauge
TIME,CH1,CH2
"""
TWINCAT = """Name\tScope Project

Name\tAmplifier\tName\tGauge
SampleTime[ms]\t5\tSampleTime[ms]\t5
Unit\tV\tUnit\tµm

"""
KEYSIGHT = "x-axis,1,2\nsecond,Volt,Volt\n"


def split(row):
    return row.split(",")


def written(file, text, encoding="utf-8"):
    file.write_bytes(text.encode(encoding))
    return file


def same(file, columns=("u", "y"), factors=(1.0, 1.0), **options):
    """The recording, which must hold U and Y, and the clock of T."""
    taken = take(file, Wanted(columns, **options))
    assert taken.step_s == pytest.approx(STEP_S)
    assert (taken.index == np.arange(SAMPLES)).all()
    np.testing.assert_allclose(taken.values, np.column_stack([factors[0] * U, factors[1] * Y]), rtol=1e-7)
    return taken


FOREIGN = {
    "german excel": ("Zeit;u;y\r\n" + "\r\n".join(lines(";", ",")), ("u", "y")),
    "spaces": ("  t   u   y\n" + "\n".join(f"  {row}" for row in lines("   ")), ("u", "y")),
    "numpy": ("# t u y\n" + "\n".join(lines(" ")), ("u", "y")),
    "matlab comments": ("% recorded on the bench\n% t, u, y\n" + "\n".join(lines()), ("u", "y")),
    "units row": ("t,u,y\ns,V,um\n" + "\n".join(lines()), ("u", "y")),
    "units row in brackets": ("t;u;y\n(s);(V);(µm)\n\n" + "\n".join(lines(";", ",")), ("u", "y")),
    "pandas with its index": (",t,u,y\n" + "\n".join(f"{k},{row}" for k, row in enumerate(lines())), ("u", "y")),
    "quoted": ('"t","u","y"\n' + "\n".join(",".join(f'"{v}"' for v in row.split(",")) for row in lines()), ("u", "y")),
    "last comma": ("t,u,y,\n" + "\n".join(f"{row}," for row in lines()), ("u", "y")),
    "labview": (LABVIEW + "\n".join(f"{row}\t" for row in lines("\t", ",")), ("Amplifier", "Gauge")),
    "tektronix": (TEKTRONIX + "\n".join(lines()), ("CH1", "CH2")),
    "keysight": (KEYSIGHT + "\n".join(lines()), ("1", "2")),
    "twincat's scope": (
        TWINCAT + "\n".join("{3}\t{1}\t{3}\t{2}".format(*r.split(";"), 5 * k) for k, r in enumerate(lines(";", ","))),
        ("Amplifier", "Gauge"),
    ),
    "ltspice": ("time\tV(amp)\tV(y)\n" + "\n".join(lines("\t")), ("V(amp)", "V(y)")),
    "german excel, cleared rows": ("Zeit;u;y\r\n" + "\r\n".join([*lines(";", ","), ";;", ";;"]) + "\r\n", ("u", "y")),
    "python on windows": ("t,u,y\r\r\n" + "\r\r\n".join(lines()) + "\r\r\n", ("u", "y")),
    "commas in quotes": ('"t, s","u, V","y, um"\n' + "\n".join(lines()), ("u, V", "y, um")),
    "quoted, decimal commas": (
        "t,u,y\n" + "\n".join(",".join(f'"{v}"' for v in row.split(";")) for row in lines(";", ",")),
        ("u", "y"),
    ),
    "a units row, one unknown": ("t,u,y,flow\ns,V,um,l/min\n" + "\n".join(f"{r},1.5" for r in lines()), ("u", "y")),
    "a units row, one missing": ("t;u;y;k\ns;V;um;-\n" + "\n".join(f"{r};1" for r in lines(";")), ("u", "y")),
    "a status beside": ("t,u,state,y\n" + "\n".join("{},{},ok,{}".format(*r.split(",")) for r in lines()), ("u", "y")),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_each_program_s_text_gives_the_same_numbers(name, tmp_path):
    text, columns = FOREIGN[name]
    assert same(written(tmp_path / "x.txt", text), columns).notes == ()


def test_a_comment_with_a_number_has_no_names(tmp_path):
    same(written(tmp_path / "x.txt", "# channel gain 20\n" + "\n".join(lines(" "))), ("2", "3"), time="1")


@settings(max_examples=60, deadline=None)
@given(
    separator=st.sampled_from([",", ";", "\t", " ", "  "]),
    decimal=st.sampled_from([".", ","]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    ending=st.sampled_from(["\n", "\r\n"]),
    preamble=st.lists(st.sampled_from(["# bench 2", "", "Operator: K. Müller", "%"]), max_size=3),
    units=st.booleans(),
    table=st.integers(2, 5).flatmap(
        lambda n: st.lists(st.lists(st.floats(-1e6, 1e6, width=32), min_size=n, max_size=n), min_size=5, max_size=20)
    ),
)
def test_any_dialect_gives_the_numbers_back(
    tmp_path_factory, separator, decimal, encoding, ending, preamble, units, table
):
    if decimal == "," == separator:
        decimal = "."
    names = [f"qµ{k}" for k in range(len(table[0]))]
    text = [separator.join(f"{value:.8e}".replace(".", decimal) for value in row) for row in table]
    head = [*preamble, separator.join(names), *([separator.join(["V"] * len(names))] if units else [])]
    file = tmp_path_factory.mktemp("dialect") / "x.csv"
    file.write_bytes((ending.join([*head, *text]) + ending).encode(encoding))
    found = read_table(file)
    assert list(found) == names
    for k, name in enumerate(names):
        np.testing.assert_allclose(found[name], [float(f"{row[k]:.8e}") for row in table], rtol=0, atol=0)
        assert found.unit(name) == ("V" if units else None)


@pytest.mark.parametrize(
    ("header", "columns", "scale"),
    [
        ("t_ms,u_V,y_um", ("u", "y"), (1e-3, 1.0, 1.0)),
        ("t [s],u [mV],y [mm]", ("u", "y"), (1.0, 1e-3, 1e3)),
        ("t / s,u / V,y / nm", ("u / V", "y"), (1.0, 1.0, 1e-3)),
        ("t\ns,kV,µm", None, (1.0, 1e3, 1.0)),
        ("time (µs),u (V),y (m)", ("u", "y"), (1e-6, 1.0, 1e6)),
        ("Time [msec],u [Volts],y [microns]", ("u", "y"), (1e-3, 1.0, 1.0)),
        ("Zeit in ms,u in mV,y in µm", ("u", "y"), (1e-3, 1e-3, 1.0)),
        ("Time us,u V,y mm", ("u", "y"), (1e-6, 1.0, 1e3)),
        ("t,u,y", ("u:mV", "y:mm"), (1.0, 1e-3, 1e3)),
        ("t,u_V,y_um", ("u_V:mV", "y:nm"), (1.0, 1e-3, 1e-3)),
    ],
)
def test_units_are_turned_into_ours(header, columns, scale, tmp_path):
    if columns is None:
        header, columns = "t,u,y\ns,kV,µm", ("u", "y")
    per = np.array(scale)
    rows = np.column_stack([T, U, Y]) / per
    text = header + "\n" + "\n".join(",".join(f"{value:.12g}" for value in row) for row in rows)
    taken = same(written(tmp_path / "x.csv", text), columns)
    turned = [note for note in taken.notes if "turned into" in note]
    assert len(turned) == sum(factor != 1.0 for factor in scale[1:])


@pytest.mark.parametrize(
    ("name", "begin", "unit", "per_s", "says"),
    [
        ("time [blinks]", 0, "ms", 1e3, r"x.csv: time \[blinks\]: 'blinks' is no unit of time known here"),
        ("timestamp", 1_795_000_000_000, "ms", 1e3, r"x.csv:2: timestamp is 1.795e\+12, .* --time timestamp:ms"),
        ("tick", 1_795_000_000_000_000, "us", 1e6, r"x.csv:2: tick is 1.795e\+15, which can't be in s; .* tick:us"),
    ],
)
def test_times_that_are_none_in_seconds_are_refused_but_where_the_unit_is_given(
    name, begin, unit, per_s, says, tmp_path
):
    rows = [f"{begin + round(per_s * t)},{u},{y}" for t, u, y in zip(T, U, Y, strict=True)]
    file = written(tmp_path / "x.csv", f"{name},u,y\n" + "\n".join(rows))
    with pytest.raises(CheckFailed, match=says):
        take(file, Wanted(("u", "y")))
    same(file, time=f"{name}:{unit}")


def test_time_by_option_and_stamps(tmp_path):
    rows = [f"2024-03-01 23:59:59.{k * 5:03d},{u},{y}" for k, (u, y) in enumerate(zip(U, Y, strict=True)) if k < 200]
    file = written(tmp_path / "x.csv", "when,u,y\n" + "\n".join(rows))
    taken = take(file, Wanted(("u", "y"), "when"))
    assert taken.step_s == pytest.approx(STEP_S, rel=1e-4)
    counter = written(
        tmp_path / "n.csv", "n,u,y\n" + "\n".join(f"{k},{u},{y}" for k, (u, y) in enumerate(zip(U, Y, strict=True)))
    )
    same(counter, time="n:samples", step_s=STEP_S)
    with pytest.raises(CheckFailed, match=r"n counts samples: give their interval, --dt"):
        take(counter, Wanted(("u", "y"), "n:samples"))
    with pytest.raises(CheckFailed, match=r"n.csv: u is in V, which is no time"):
        take(counter, Wanted(("y",), "u:V"))


BAD = {
    "begun again": (
        "t,u,y\n" + "\n".join([*lines()[:400], "t,u,y", *lines()[:200]]),
        r"x.csv:402: a second table begins here",
    ),
    "labview, two segments": (
        LABVIEW
        + "\n".join(lines("\t", ","))
        + "\n\n"
        + LABVIEW.partition("\nChannels")[2]
        + "\n".join(lines("\t", ",")),
        "a second table begins here",
    ),
    "two clocks": (
        "X,u,X,y\ns,V,s,um\n" + "\n".join(f"{t},{u},{2 * float(t)},{y}" for t, u, y in map(split, lines())),
        r"X and X.2 have different times: say which .* --time X or --time X.2",
    ),
    "a time in words": (
        "Time,u,y\n" + "\n".join(f"15h 02m {t}s,{u},{y}" for t, u, y in map(split, lines())),
        r"Time has '15h 02m 0s', which is no time known here: 2026-11-24 15:02:10.5",
    ),
    "an input of texts": (
        "t,u,y\n" + "\n".join(f"{t},{u} V,{y}" for t, u, y in map(split, lines())),
        r"u holds no numbers",
    ),
    "thousands in a column": (
        "t;u;y [um]\n" + "\n".join(f"{t};{u};{1e4 * float(y):,.1f}" for t, u, y in map(split, lines())),
        r"y \[um\] holds no numbers, but '-?\d+,\d",
    ),
    "blocks": ("t u y\n" + "\n".join([*lines(" ")[:300], "", *lines(" ")[:300]]), r"x.csv:303: t falls by 1.49"),
    "points among commas": (
        "t;u;y\n" + "\n".join([*lines(";", ",")[:300], "1,5;40,25;3.25", *lines(";", ",")[300:]]),
        r"x.csv:302: '3.25' is no number",
    ),
    "thousands of whole numbers": (
        "t,u,y\n" + "\n".join([*lines()[:300], '1.5,40.25,"1,234"', *lines()[300:]]),
        r"x.csv:302: '1,234' is no number",
    ),
    "cut off": (
        "t,u,y\n" + "\n".join(lines()[:-1]) + "\n2.9",
        r"x.csv:601: this row has not as many .* may be cut off",
    ),
    "a row is short": ("t,u,y\n" + "\n".join([*lines()[:300], "1,2", *lines()[300:]]), r"x.csv:302: this row has not"),
    "a word": ("t,u,y\n" + "\n".join([*lines()[:300], "1,off,2", *lines()[300:]]), r"x.csv:302: 'off' is no number"),
    "a name is missing": (
        "t,u\n" + "\n".join(lines()),
        r"x.csv:1: the header has 2 names, the rows have 3 values each",
    ),
    "ltspice steps": (
        "time\tu\ty\n"
        + "\n".join(["Step Information: R=1 (Run: 1/2)", *lines("\t"), "Step Information: R=2", *lines("\t")]),
        r"x.csv:603: a second table begins here",
    ),
    "a letter": ("Dear reader,\nthis is a letter.\n", "x.csv: not a table of numbers"),
    "utf-16, half": ("", "the file is cut off or damaged"),
    "time falls": ("t,u,y\n" + "\n".join([*lines()[:300], *lines()[100:]]), r"x.csv:302: t falls by 0.995 s here"),
    "no number": (
        "t,u,y\n" + "\n".join(f"{t},nan,{y}" for t, _, y in map(split, lines())),
        r"x.csv:2: u has no number at",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_text_is_one_sentence_with_its_line(name, tmp_path):
    text, sentence = BAD[name]
    file = written(tmp_path / "x.csv", text)
    if name == "utf-16, half":
        file.write_bytes(("t,u,y\n" + "\n".join(lines())).encode("utf-16")[:-1])
    with pytest.raises(CheckFailed, match=sentence) as raised:
        take(file, Wanted(("u", "y")))
    assert "\n" not in str(raised.value)


def test_names_that_are_not_there_are_told_with_what_is(tmp_path):
    file = written(tmp_path / "x.csv", "t,voltage_V,y\n" + "\n".join(lines()))
    with pytest.raises(CheckFailed, match=r"no column voltage_mV; did you mean voltage_V\?"):
        take(file, Wanted(("voltage_mV", "y")))
    with pytest.raises(CheckFailed, match=r"y:furlong: 'furlong' is no unit known here"):
        take(file, Wanted(("voltage", "y:furlong")))
    with pytest.raises(UsageError, match="the column y is named twice"):
        take(file, Wanted(("y", "y:mm")))
