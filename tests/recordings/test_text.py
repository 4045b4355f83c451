"""Texts as spreadsheets, oscilloscopes, LabVIEW and simulators write them: the same numbers come out of each."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micromanip.errors import CheckFailed, UsageError
from micromanip.recordings import Wanted, read_table, take

from .signals import SAMPLES, STEP_S, T, U, Y, lines

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
    "comma": ("t,u,y\n" + "\n".join(lines()), ("u", "y")),
    "windows": ("t,u,y\r\n" + "\r\n".join(lines()) + "\r\n", ("u", "y")),
    "german excel": ("Zeit;u;y\r\n" + "\r\n".join(lines(";", ",")), ("u", "y")),
    "semicolons": ("t;u;y\n" + "\n".join(lines(";")), ("u", "y")),
    "tabs": ("t\tu\ty\n" + "\n".join(lines("\t")), ("u", "y")),
    "tabs, decimal commas": ("t\tu\ty\n" + "\n".join(lines("\t", ",")), ("u", "y")),
    "spaces": ("  t   u   y\n" + "\n".join(f"  {row}" for row in lines("   ")), ("u", "y")),
    "spaces, decimal commas": ("t u y\n" + "\n".join(lines(" ", ",")), ("u", "y")),
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
    assert same(written(tmp_path / "x.txt", text), columns).notes == []


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_encodings(encoding, tmp_path):
    file = written(tmp_path / "x.csv", "t (s),u (V),y (µm)\n" + "\n".join(lines()), encoding)
    same(file)
    same(file, ("u (V)", "y (µm)"))


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
    names = [f"q{k}" for k in range(len(table[0]))]
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
