"""Tables at any width: what stands in them is never cut."""

import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from micromanip.cli.tables import Figures
from micromanip.cli.values import values

WORDS = st.lists(st.text("abcxyz0123456789.", min_size=1, max_size=14), min_size=1, max_size=4).map(" ".join)


def printed(renderable, width):
    out = io.StringIO()
    Console(file=out, width=width, highlight=False).print(renderable)
    return out.getvalue()


def words(text):
    return re.sub(r"[^\w.\-]+", " ", text).split()


@given(st.lists(st.lists(WORDS, min_size=3, max_size=3), min_size=1, max_size=5), st.integers(24, 160))
def test_every_word_is_shown_whole_and_no_line_is_too_long(rows, width):
    table = Figures("first", "second", "third", title="a title")
    for row in rows:
        table.add_row(*row)
    shown = printed(table, width)
    assert max(len(line) for line in shown.splitlines()) <= width
    seen = words(shown)
    for word in (word for row in rows for cell in row for word in cell.split()):
        assert word in seen, shown


def test_a_wide_one_is_a_table_and_a_narrow_one_is_stacked():
    table = Figures("axis", "uncompensated rms", "rms", title="Path error, um")
    table.add_row("x", "114.3", "0.814")
    assert "│ x    │ 114.3             │ 0.814 │" in printed(table, 80)
    assert printed(table, 30).splitlines() == ["Path error, um", "axis x", "  uncompensated rms 114.3", "  rms 0.814"]


def test_a_stacked_figure_goes_on_beside_or_below_its_header():
    table = Figures("begun", "file", "about")
    table.add_row("today", "/var/lib/micromanip/trips/one.npz", "no usable sample of the reference")
    shown = [line.rstrip() for line in printed(table, 36).splitlines()]
    assert shown[:2] == ["begun today", "  file"]
    assert "".join(shown[2:4]).replace(" ", "") == "/var/lib/micromanip/trips/one.npz"
    assert shown[4:] == ["  about no usable sample of the", "        reference"]


def known(latest, deviation, peak):
    window = dict.fromkeys(("seconds", "mean", "min", "max", "rms", "peak"), peak)
    window |= {"deviation_rms": deviation, "deviation_peak": peak}
    return {"latest": latest, "unknown": None, "second": window, "minute": window}


@pytest.fixture
def report():
    axis = {
        "position_um": known(-101.25, 0.125, 1.5),
        "setpoint_um": {"latest": None, "unknown": "loops open", "second": None, "minute": None},
        "strain_um": {
            "latest": None,
            "unknown": "stale: no usable sample",
            "second": None,
            "minute": known(1, 2, 3)["minute"],
        },
        "voltage_V": known(148.0, 0.25, 2.5),
        "headroom_V": known(2.0, 0.25, 1.75),
        "error_um": known(0.5, 9.0, 0.75),
        "error_of": "path",
        "tooth_Hz": None,
        "joints_Hz": [],
    }
    return {"axes": {"x": axis}}


@pytest.mark.parametrize("width", [40, 80, 120])
def test_values_at_every_width(report, width):
    shown = printed(values(report), width)
    assert max(len(line) for line in shown.splitlines()) <= width
    assert {"-101.250", "0.125", "148.000", "2.000", "1.750", "0.750", "unknown", "stale"} <= set(words(shown))
    assert "9.000" not in shown, "the error's rms is about zero"
    said = " ".join(shown.split())
    assert "unknown: x set-point: loops open" in said
    assert "unknown: x strain: stale: no usable sample" in said
