"""`micromanip trend`: days, hours, gaps, pictures, and what it refuses."""

import json

import numpy as np
import pytest

from .command import code_of

HEAD = "time,seconds,cycles,overruns,link_down_cycles,state,fault,lateness_us_max,error_um_x_rms,headroom_V_x_min"
START = np.datetime64("2026-11-01T23:00:00", "s")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Minutes of four days: an hour of 0.3 um with a fault, a night without any, then 0.4 um."""
    place = tmp_path_factory.mktemp("trend")
    days = {}
    for k in [*range(60), *range(600, 60 * 72)]:
        time = str(START + np.timedelta64(60 * k, "s"))
        error = 0.3 if k < 60 else 0.4
        fault = 1 if k == 30 else 0
        row = f"{time},60,600000,2,0,7,{fault},{k},{error},{20 - k / 1000:g}\n"
        days[time[:10]] = days.get(time[:10], f"{HEAD}\n") + row
    for day, text in days.items():
        (place / f"{day}-minutes.csv").write_text(text)
    return place


def answer(capsys, *arguments):
    assert code_of("trend", *arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_days(folder, capsys):
    found = answer(capsys, folder)
    assert [period["begins"] for period in found["periods"]] == [f"2026-11-0{day}" for day in (1, 2, 3, 4)]
    assert found["rows"] == 60 + 3720
    first, second = found["periods"][:2]
    assert (first["running_h"], first["overruns"], first["error_um_x_rms"]) == (1.0, 120, 0.3)
    assert (second["running_h"], second["lateness_us_max"]) == (15.0, 1499)
    assert len(first["faults"]) == 1
    assert second["faults"] == []
    assert found["gaps"] == [{"from": "2026-11-02T00:00:00", "to": "2026-11-02T09:00:00", "seconds": 32_400}]


def test_how_figures_went(folder, capsys):
    """Forty-eight equal times of 72 hours, of which the second to the sixth lie in the night."""
    found = answer(capsys, folder, "--field", "error_um_x", "--field", "lateness_us_max")
    assert (found["from"], found["to"]) == ("2026-11-01T23:00:00", "2026-11-04T22:59:00")
    error, late = found["courses"]
    assert error == {
        "field": "error_um_x_rms", "drawn": "▁" + 5 * " " + "█" + 41 * "█", "least": 0.3, "greatest": 0.4, "last": 0.4
    }  # fmt: skip
    assert (late["least"], late["greatest"], late["last"]) == (59, 4319, 4319)
    assert list(late["drawn"].replace(" ", "")) == sorted(late["drawn"].replace(" ", ""))
    assert code_of("trend", folder, "--field", "lateness_us_max") == 0
    assert late["drawn"] in capsys.readouterr().out


def test_hours_of_two_days(folder, capsys):
    found = answer(capsys, folder, "--until", "2026-11-02T10:30", "--field", "error_um_x", "--field", "state")
    periods = {period["begins"]: period for period in found["periods"]}
    assert list(periods) == ["2026-11-01T23", "2026-11-02T09", "2026-11-02T10"]
    assert periods["2026-11-02T10"]["running_h"] == 0.5
    assert periods["2026-11-02T10"]["error_um_x_rms"] == pytest.approx(0.4)
    assert set(periods["2026-11-02T10"]) == {"begins", "running_h", "error_um_x_rms", "state", "faults"}


def test_an_rms_of_a_day_is_weighted_by_time(tmp_path, capsys):
    file = tmp_path / "2026-11-01-minutes.csv"
    rows = ["2026-11-01T10:00:00,60,1,0,0,7,0,1,3,1", "2026-11-01T10:01:00,20,1,0,0,7,0,1,5,nan"]
    file.write_text("\n".join([HEAD, *rows, "2026-11-01T10:02:00,6"]))
    (period,) = answer(capsys, file)["periods"]
    assert period["error_um_x_rms"] == pytest.approx(np.sqrt((60 * 9 + 20 * 25) / 80))
    assert period["headroom_V_x_min"] == 1


def test_table_of_people(folder, capsys):
    assert code_of("trend", folder) == 0
    said = capsys.readouterr().out
    assert "nothing ran from 2026-11-02T00:00:00 to 2026-11-02T09:00:00 (9.0 h)" in said
    assert "2026-11-03" in said


def test_to_csv_and_back(folder, tmp_path, capsys):
    to = tmp_path / "2026-11-03-minutes.csv"
    assert code_of("trend", folder, "--since", "2026-11-03", "--until", "2026-11-04", "--to", to) == 0
    assert to.read_text() == (folder / to.name).read_text()
    assert code_of("trend", folder, "--to", to) == 64
    assert "is there already" in capsys.readouterr().err


def test_what_is_not_known_is_written_as_other_programs_read_it(tmp_path):
    """Also where the file is of a version that wrote ``nan``."""
    old, to = tmp_path / "2026-11-01-minutes.csv", tmp_path / "new.csv"
    old.write_text(f"{HEAD}\n2026-11-01T10:00:00,60,600000,2,0,7,0,1,nan,3\n")
    assert code_of("trend", old, "--to", to) == 0
    assert to.read_text().splitlines()[1].split(",")[-2:] == ["NaN", "3"]


def test_a_picture_has_no_line_over_a_gap(folder, tmp_path):
    to = tmp_path / "error.svg"
    assert code_of("trend", folder, "--field", "error_um_x_rms", "--to", to) == 0
    text = to.read_text()
    line = text[text.index('<g id="line2d', text.index("xtick")) :]
    assert "error_um_x_rms" in text
    curves = [part for part in line.split("<path ") if part.count("L ") > 0 and part.count("M ") == 2]
    assert curves, "the line is broken once"


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("--field", "error_um_z"), 64, "no column error_um_z; did you mean error_um_x_rms?"),
        (("--since", "yesterday"), 64, "--since yesterday: expected a date"),
        (("--since", "2026-13-01"), 64, "--since 2026-13-01: expected a date"),
        (("--since", "2027-01-01"), 1, "no minute of a trend in it at that time"),
        (("--every", "second"), 1, "no trend in it, no file called 2026-11-23-seconds.csv"),
        (("--to", "trend.pdf"), 64, "written as .csv, or drawn as .svg or .png"),
    ],
)
def test_refused(folder, capsys, arguments, code, said):
    assert code_of("trend", folder, *arguments) == code
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"cycle,x\n1,2\n", ":1: no trend of ours: its first column is 'cycle'"),
        (b"time,error_um_x_rms\n2026-11-01T10:00:00,1\n", ":1: no whole trend: it has no column cycles"),
        (f"{HEAD}\n2026-11-01T10:00:00,1,1\n".encode(), ":2: this row has 3 values, the head 10"),
        (f"{HEAD}\n2026-11-01T10:00:00,1,1,0,0,7,0,much,1,1\n".encode(), ":2: could not convert"),
        (f"{HEAD}\nyesterday,1,1,0,0,7,0,1,1,1\n".encode(), ":2: "),
        (b"\x00\xff" * 100 + b"\n", ":1: no trend of ours"),
    ],
)
def test_damaged(tmp_path, capsys, content, said):
    file = tmp_path / "2026-11-01-minutes.csv"
    file.write_bytes(content)
    assert code_of("trend", tmp_path) == 1
    error = capsys.readouterr().err
    assert f"{file}{said}" in error
    assert "bug" not in error


def test_foreign_file(tmp_path, capsys):
    assert code_of("trend", tmp_path / "nowhere") == 1
    assert "no such file or folder" in capsys.readouterr().err
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    assert code_of("trend", tmp_path / "notes.csv") == 1
    assert "notes.csv: no trend" in capsys.readouterr().err
