"""The page of what the cell reaches: its tables, and that what stands in it can be."""

import re

import pytest

from tools.accuracy.figures import BEFORE, BOUND, NOW, UNCOMPENSATED, Reached, true_sigma
from tools.accuracy.page import PAGE, RealLoop, lines, page, spread

ROW = re.compile(r"^\| (?P<row>[^|]+?) \|(?P<cells>.*)\|$", re.MULTILINE)


def reached(path, **more):
    return Reached(
        {UNCOMPENSATED: 100.0, NOW: path, BOUND: 0.15} | more, {"force": 0.2}, {"A 1": 0.2}, {"A 1": 0.1}, {}
    )


def printed(own, plants):
    real = RealLoop({axis: {"rms": 0.7} for axis in own}, 20.0, 3, "2 CPUs")
    return page(own, plants, real, {axis: {"0.5 um of noise: left": 0.3} for axis in own})


def cells(text, row):
    (found,) = [each["cells"] for each in ROW.finditer(text) if each["row"] == row]
    return [cell.strip() for cell in found.split("|")]


def test_median_and_worst_are_of_the_plants_that_passed():
    own = {"x": reached(0.5, **{BEFORE: 0.6})}
    text = printed(own, {200: reached(0.4), 201: "axis x: it does not move", 202: reached(0.9), 203: reached(0.5)})
    assert "4 in all" in text
    assert re.search(r"\b3\s+passed", text)
    assert cells(text, NOW) == ["0.500", "0.500", "0.900"]
    assert "- 201: axis x: it does not move" in text


def test_what_was_not_measured_is_left_open_and_not_made_up():
    text = printed({"x": reached(0.5, **{BEFORE: 0.6})}, {200: reached(0.4)})
    assert cells(text, BEFORE) == ["0.600", "", ""]
    assert lines(["a"], {"x": {}}) == ["| | x |", "|---|---|", "| a | |"]
    assert spread([]) == ({}, {})


@pytest.mark.parametrize("row", [NOW, BEFORE])
def test_the_page_as_it_stands_is_between_bound_and_uncompensated(row):
    text = PAGE.read_text(encoding="utf-8").split("### ")[0]
    columns = zip(cells(text, BOUND), cells(text, row), cells(text, UNCOMPENSATED), strict=True)
    seen = [[float(cell) for cell in column] for column in columns if all(column)]
    assert len(seen) >= 3
    assert all(bound < left < moved for bound, left, moved in seen)


def test_a_sine_that_is_not_borne_has_no_figure_and_small_ones_are_shares_of_the_stroke_too():
    sine = {"config": "D", "frequency_hz": 50.0, "amplitude_um": 10.0, "refused": None}
    rows = [
        sine | {"true_std_error_um": 0.006, "true_rms_percent": 0.03},
        sine | {"frequency_hz": 1.0, "amplitude_um": 30.0, "true_std_error_um": 0.007, "true_rms_percent": 0.01},
        sine | {"frequency_hz": 100.0, "refused": "axis x: X-216"},
    ]
    assert true_sigma(rows) == {
        "D 50 Hz, 10 um": 0.006,
        "D 50 Hz, 10 um, % of the stroke": 0.03,
        "D 1 Hz, 30 um": 0.007,
    }
