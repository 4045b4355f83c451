"""Each broken configuration is the good one with one thing wrong; the whole message is asserted, line and hint."""

import pytest

from micromanip.settings.load import load
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii
from micromanip.settings.schema.model import Configuration


def test_good_configuration_loads(cell):
    configuration = load(cell.good)
    assert isinstance(configuration.axes["x"].hysteresis, PrandtlIshlinskii)
    assert configuration.axes["x"].setpoint.range_um == (5.0, 125.0)  # whole numbers are numbers too
    assert configuration.signals["deviation_x"].max_age_us is None


KEYS = {
    "wrong unit": (
        ("Ti_ms: 0.571", "Ti_s: 0.000571"),
        "41: axes.x.inner.Ti_s: unknown key Ti_s: did you mean Ti_ms (milliseconds)?",
    ),
    "unit left out": (
        ("offset_um: 0", "offset: 0"),
        "21: reference.offset: unknown key offset: did you mean offset_um (micrometres)?",
    ),
    "indented too little": (
        ("      filter_ms: 0.3", "    filter_ms: 0.3"),
        "43: axes.x.filter_ms: unknown key filter_ms here: it belongs to axes.x.inner",
    ),
    "an entry where a section should be": (
        ("    park_V: 0", "  park_V: 0"),
        "18: outputs.park_V: expected a section, not 0: park_V is a key of such a section, indent it further",
    ),
    "key of another variant": (
        ("source: sine", "source: sine\n  step_um: 3"),
        "21: reference.step_um: unknown key step_um here: it belongs to reference with source: step",
    ),
    "missing": (
        ("      Ti_ms: 0.571\n", ""),
        "38: axes.x.inner.Ti_ms: missing, it takes a number from 0.001 to 3600000 (milliseconds): Integral time",
    ),
    "duplicate": (
        ("    park_V: 0", "    park_V: 0\n    park_V: 10"),
        "19: outputs.voltage_x.park_V: duplicate key, it is already on line 18; delete one",
    ),
}

VALUES = {
    "the key's own unit in the value": (
        ("Ti_ms: 0.571", 'Ti_ms: "0.571 ms"'),
        "41: axes.x.inner.Ti_ms: expected a number from 0.001 to 3600000, not the text '0.571 ms': "
        "the key names the unit, write Ti_ms: 0.571",
    ),
    "decimal comma": (
        ("Td_ms: 0.167", "Td_ms: 0,167"),
        "42: axes.x.inner.Td_ms: expected a number from 0 to 3600000, not the text '0,167': write Td_ms: 0.167",
    ),
    "not whole": (
        ("rate_hz: 10000", "rate_hz: 1e4"),
        "4: loop.rate_hz: expected a whole number from 100 to 20000, not 10000.0: write rate_hz: 10000",
    ),
    "yes is not true": (
        ("arm_on_start: false", "arm_on_start: yes"),
        "44: arm_on_start: expected true or false, not the text 'yes': write arm_on_start: true",
    ),
    "not one of the choices": (
        ("mode: pid+feedforward", "mode: pid+feedfoward"),
        "39: axes.x.inner.mode: expected pid, pid+feedforward or feedforward, not the text 'pid+feedfoward': "
        "did you mean pid+feedforward?",
    ),
    "a list without brackets": (
        ("[-20, 150]", "-20, 150"),
        "16: outputs.voltage_x.range_V: expected a list of 2 numbers, each from -10000 to 10000, not the text "
        "'-20, 150': write range_V: [-20, 150]",
    ),
    "a rule of the section": (
        ("centre_um: 65", "centre_um: 650"),
        "28: axes.x.centre_um: centre_um 650 is outside setpoint.range_um 5..125",
    ),
    "a rule of a union's variant": (
        ("[0.1, 0.08, 0.05]", "[0.1, -1.2, 0.05]"),
        "37: axes.x.hysteresis.weights: alpha plus the first 2 weights is -0.1; "
        "every partial sum must be positive for the inverse to exist",
    ),
}

SYNTAX = {
    "tab": (
        ("      filter_ms: 0.3", "\tfilter_ms: 0.3"),
        "43: not YAML: character '\\t' can't start a value; indent with spaces, quote the text",
    ),
    "second document": (
        ("arm_on_start: false", "---\narm_on_start: false"),
        "44: not YAML: a second document begins here; a configuration is a single one",
    ),
    "left-over template": (
        ("centre_um: 65", "centre_um: {{ centre }}"),
        "28: axes.x.centre_um: a key must be a plain name, not a list or section",
    ),
    "tag": (
        ("mode: strain", "mode: !!python/name:os.system"),
        "27: axes.x.mode: the tag '!!python/name:os.system' isn't known here; leave it out",
    ),
    "nested without end": (("seed: 1", f"seed: {'[' * 60}{']' * 60}"), "8: drivers.cell.seed: nested too deeply"),
    "alias of itself": (
        ("      range_um: [5, 125]", "      range_um: &range [5, *range]"),
        "30: axes.x.setpoint.range_um[1]: an alias of the section it stands in",
    ),
}


CASES = [pytest.param(*case, id=name) for table in (KEYS, VALUES, SYNTAX) for name, case in table.items()]


@pytest.mark.parametrize(("change", "expected"), CASES)
def test_one_thing_wrong(cell, change, expected):
    assert cell.message(cell.with_change(*change)) == f"cell.yaml:{expected}"


SECTIONS = ", ".join(Configuration.model_fields)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", f":1: expected the sections {SECTIONS}; the file holds nothing"),
        ("- 1", f":1: expected the sections {SECTIONS}; the file holds a list"),
        ("\n\nhello", f":3: expected the sections {SECTIONS}; the file holds a single value"),
        (b"a: 1\nb: \xff", ":2: not UTF-8 text (byte 0xff); save it as UTF-8"),
        (
            "a: 1".encode("utf-16"),
            ":1: not UTF-8 text (byte 0xff): it is UTF-16, as Windows writes what it calls Unicode; save it as UTF-8",
        ),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", ":1: not UTF-8 text (byte 0x89): no text at all; name the YAML file"),
        (b"a: 1\nb: \0", ":2: character '\\x00' can't stand in YAML"),
        (b"a" * 1_000_001, ": larger than 1000 kB; is it really a configuration?"),
        ("[" * 3000, ":1: nested too deeply"),
        ('a: "\\U99999999"', ":1: not YAML: an escape sequence or a %YAML line with an impossible number"),
    ],
    ids=["empty", "list", "scalar", "binary", "utf-16", "picture", "zero byte", "huge", "deep", "escape"],
)
def test_no_configuration_at_all(cell, content, expected):
    assert cell.message(content) == f"cell.yaml{expected}"


def test_only_the_first_ten_problems_are_shown(cell):
    lines = cell.message(cell.text + "".join(f"unknown{i}: {i}\n" for i in range(13))).splitlines()
    assert len(lines) == 11
    assert lines[0].startswith("cell.yaml:45: unknown0: unknown key unknown0")
    assert lines[-1] == "cell.yaml: and 3 more"
