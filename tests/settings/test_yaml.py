"""YAML as people read it, and nothing but clear messages whatever the file holds."""

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micromanip.errors import ConfigError
from micromanip.settings.load import load
from micromanip.settings.schema.model import Configuration

NUMBERS = {"1e-3": 1e-3, "+.5": 0.5, "1.": 1.0, "1E+2": 100.0, "0x10": 16, "0o10": 8, "010": 10, "-7": -7}


@pytest.mark.parametrize("written", NUMBERS)
def test_numbers_are_those_of_yaml_1_2(cell, written):
    configuration = load(cell.write(cell.with_change("offset_um: 0", f"offset_um: {written}")))
    assert configuration.reference.offset_um == NUMBERS[written]


@pytest.mark.parametrize("text", ["on", "no", "y", "12:30", "2026-01-31", "1_000", "=", "0x", "1e", "nan"])
def test_text_stays_text(cell, text):
    configuration = load(cell.write(cell.with_change("max_age_us: null", f"channel: {text}")))
    assert configuration.signals["deviation_x"].channel == text


def test_second_axis_by_merge_key(cell):
    text = cell.with_change("    setpoint:\n", "    setpoint: &shared\n").replace("  x:\n", "  x: &x\n")
    text = text.replace(
        "arm_on_start", "  y:\n    <<: *x\n    setpoint: {<<: *shared, slew_um_per_ms: 3}\narm_on_start"
    )
    axes = load(cell.write(text)).axes
    assert axes["y"].inner == axes["x"].inner
    assert axes["y"].setpoint.range_um == (5.0, 125.0)
    assert axes["y"].setpoint.slew_um_per_ms == 3.0


def test_aliases_that_expand_without_end(cell):
    levels = "\n".join(f"  b{i}: &b{i} [{', '.join([f'*b{i - 1}'] * 10)}]" for i in range(1, 9))
    found = cell.message(f"a:\n  b0: &b0 [1]\n{levels}\n")
    assert re.fullmatch(r"cell.yaml:\d+: a.*: more than 100000 values; aliases are counted where they are used", found)


def loads_or_explains(file, content):
    """The answer is a configuration, or lines of text that a terminal can show."""
    file.write_bytes(content)
    try:
        assert isinstance(load(file), Configuration)
    except ConfigError as error:
        lines = str(error).split("\n")
        assert all(line.startswith(str(file)) and line.encode() and line.isprintable() for line in lines)


@pytest.fixture(scope="module")
def any_file(tmp_path_factory):
    return tmp_path_factory.mktemp("any") / "any.yaml"


@settings(deadline=None)
@given(content=st.binary() | st.text().map(str.encode))
def test_any_content(any_file, content):
    loads_or_explains(any_file, content)


VALUES = ["", "~", "1", "-1", "1e9", "1e999", ".nan", "true", "[]", "{}", "[[1]]", "{a: 1}", "*a", "&a 1", "!!int x"]
VALUES += ["<<", "&a\n<<: *a", "&a\n  <<: [*a, *a]", "|", "? 1", '"\\ud800"', '"\\n"']


@settings(deadline=None)
@given(data=st.data())
def test_good_configuration_with_any_line_changed(any_file, good_lines, data):
    """One line gets another key, something in its middle, or another value."""
    number = data.draw(st.integers(0, len(good_lines) - 1))
    text = data.draw(st.sampled_from(VALUES) | st.text(max_size=8))
    key, colon, value = good_lines[number].partition(": ")
    changed = data.draw(st.sampled_from([f"{text}{colon}{value}", f"{key}{text}{colon}{value}", f"{key}: {text}"]))
    loads_or_explains(any_file, "\n".join([*good_lines[:number], changed, *good_lines[number + 1 :]]).encode())
