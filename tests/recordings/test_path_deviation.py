"""The path deviation of a robot as a file: dialects and units of others, and what is refused, with its line."""

import numpy as np
import pytest

from micromanip.errors import CheckFailed
from micromanip.recordings.path_deviation import read_path_deviation

ROWS = [(0.5, 1.0, -2.0), (0.6, 1.5, -2.5), (0.7, 2.0, -3.0), (0.8, 2.25, -4.0)]


def written(folder, header, rows=ROWS, separator=",", decimal=".", encoding="utf-8"):
    lines = [header, *(separator.join(f"{value!r}".replace(".", decimal) for value in row) for row in rows)]
    file = folder / "path.csv"
    file.write_text("\r\n".join(lines) + "\r\n", encoding=encoding, newline="")
    return file


@pytest.mark.parametrize(
    ("header", "dialect", "factors"),
    [
        ("t_s,deviation_x_um,deviation_y_um", {}, (1.0, 1.0)),
        ("t_s;deviation_x_um;deviation_y_um", {"separator": ";", "decimal": ","}, (1.0, 1.0)),
        ("time (s)\tx [um]\ty [um]", {"separator": "\t", "decimal": ",", "encoding": "utf-8-sig"}, (1.0, 1.0)),
        ("t_ms,x (mm),deviation_um_y", {"encoding": "utf-16"}, (1e3, 1.0)),
    ],
)
def test_tables_of_other_programs_are_the_same_path(tmp_path, header, dialect, factors):
    path = read_path_deviation(written(tmp_path, header, **dialect), ["x", "y"])
    scale = 1e-3 if header.startswith("t_ms") else 1.0
    np.testing.assert_allclose(path.time_s, scale * np.array([0.0, 0.1, 0.2, 0.3]), atol=1e-12)
    np.testing.assert_allclose(path.deviation_um, np.array(ROWS)[:, 1:] * factors, rtol=1e-12)
    said = "x (mm) is in mm: taken times 1000"
    assert [said in note for note in path.notes].count(True) == (1 if "mm" in header else 0)
    assert path.even_step_s() == pytest.approx(0.1 * scale)


@pytest.mark.parametrize(
    ("header", "rows", "message"),
    [
        ("t_s,deviation_x_um,z_um", ROWS, r"path\.csv: there is no column deviation_y_um; did you mean deviation_x_um"),
        ("t_s,x,deviation_y_um", ROWS, r"path\.csv: the column x states no unit; call it x_um, or x \(um\)"),
        ("t_s,x_V,y_um", ROWS, r"path\.csv: the column x_V is in V, which is no unit of length; give um"),
        ("time,x_um,y_um", ROWS, r"path\.csv: the column time states no unit; call it t_s"),
        ("p_um,x_um,y_um", ROWS, r"path\.csv: no column is a time; call it t_s"),
        ("t_s,x_um,deviation_x_um", ROWS, "no column deviation_y_um"),
        ("t_s,x_um,y_um", [*ROWS, (0.7, 1.0, 1.0)], r"path\.csv:6: t_s falls by 0\.1 s here"),
        ("t_s,x_um,y_um", [*ROWS, (0.8, 1.0, 1.0)], r"path\.csv:6: t_s stands still here"),
        ("t_s,x_um,y_um", [ROWS[0], (0.6, float("nan"), 1.0), *ROWS[2:]], r"path\.csv:3: x_um has no number here"),
        ("t_s,x_mm,y_um", [*ROWS[:3], (0.8, 412.5, 1.0)], r"path\.csv:5: x_mm is 412\.5 mm: a deviation is"),
        ("t_s,x_um,y_um", ROWS[:1], r"path\.csv:2: one row is no path"),
    ],
)  # fmt: skip
def test_what_is_no_deviation_is_told_with_its_place(tmp_path, header, rows, message):
    with pytest.raises(CheckFailed, match=message):
        read_path_deviation(written(tmp_path, header, rows), ["x", "y"])


def test_rows_that_are_played_are_even(tmp_path):
    path = read_path_deviation(written(tmp_path, "t_s,x_um,y_um", [*ROWS, (1.0, 1.0, 1.0)]), ["x"])
    with pytest.raises(CheckFailed, match=r"row 4 comes 0\.2 s after the one before, the others 0\.1 s"):
        path.even_step_s()
