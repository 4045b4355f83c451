"""Each broken configuration is the good one with one thing wrong; the whole message is asserted, line and hint included."""

import hashlib
import re
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field

from micromanip.errors import ConfigError
from micromanip.settings.hysteresis import PrandtlIshlinskii
from micromanip.settings.load import load, load_with_source, validate_section
from micromanip.settings.model import Configuration

GOOD = Path(__file__).with_name("cell.yaml")
TEXT = GOOD.read_text()


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Write a configuration; its relative name keeps the messages short."""
    monkeypatch.chdir(tmp_path)

    def write_bytes(content: str | bytes) -> Path:
        file = Path("cell.yaml")
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
        return file

    return write_bytes


def message(file: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load(file)
    return str(caught.value)


def with_change(old: str, new: str) -> str:
    assert TEXT.count(old) == 1, f"{old!r} must single out one place in {GOOD.name}"
    return TEXT.replace(old, new)


def test_good_configuration_loads():
    configuration = load(GOOD)
    hysteresis = configuration.axes["x"].hysteresis
    assert isinstance(hysteresis, PrandtlIshlinskii)
    assert hysteresis.coefficients == (0.8, 1e-3)  # written 1e-3, which YAML 1.1 takes for text
    assert configuration.axes["x"].setpoint.range_um == (5.0, 125.0)  # whole numbers are numbers too
    assert configuration.signals["deviation_x"].max_age_us is None


KEYS = {
    "wrong unit": (
        ("Ti_ms: 0.571", "Ti_s: 0.000571"),
        "41: axes.x.inner.Ti_s: unknown key Ti_s: did you mean Ti_ms (milliseconds)?",
    ),
    "wrong compound unit": (
        ("K_V_per_um: 0.6", "K_V_per_mm: 600"),
        "40: axes.x.inner.K_V_per_mm: unknown key K_V_per_mm: did you mean K_V_per_um (volts per micrometre)?",
    ),
    "wrong unit prefix": (
        ("range_V: [-20, 150]", "range_mV: [-20000, 150000]"),
        "16: outputs.voltage_x.range_mV: unknown key range_mV: did you mean range_V (volts)?",
    ),
    "unit left out": (
        ("offset_um: 0", "offset: 0"),
        "21: reference.offset: unknown key offset: did you mean offset_um (micrometres)?",
    ),
    "typing error": (
        ("arm_on_start: false", "arm_on_strat: false"),
        "44: arm_on_strat: unknown key arm_on_strat: did you mean arm_on_start?",
    ),
    "nothing like it": (
        ("  limits: simulation", "  limits: simulation\n  watchdog: 3"),
        "7: loop.watchdog: unknown key watchdog: known here are rate_hz, cpu, priority, spin_us, limits",
    ),
    "indented too little": (
        ("      filter_ms: 0.3", "    filter_ms: 0.3"),
        "43: axes.x.filter_ms: unknown key filter_ms here: it belongs to axes.x.inner",
    ),
    "an entry where a section should be": (
        ("    park_V: 0", "  park_V: 0"),
        "18: outputs.park_V: expected a section, not 0: park_V is a key of such a section, indent it further",
    ),
    "key of a list's entries": (
        ("  sines:", "  amplitude_um: 30\n  sines:"),
        "22: reference.amplitude_um: unknown key amplitude_um here: it belongs to reference.sines[0]",
    ),
    "key of another variant": (
        ("source: sine", "source: sine\n  step_um: 3"),
        "21: reference.step_um: unknown key step_um here: it belongs to reference with source: step",
    ),
    "missing": (
        ("      Ti_ms: 0.571\n", ""),
        "38: axes.x.inner.Ti_ms: missing, it takes a number greater than 0 (milliseconds): Integral time",
    ),
    "missing tag of a union": (
        ("      model: pi\n", ""),
        "31: axes.x.hysteresis.model: missing, it takes pi, network or none",
    ),
    "duplicate": (
        ("    park_V: 0", "    park_V: 0\n    park_V: 10"),
        "19: outputs.voltage_x.park_V: duplicate key, it is already on line 18; delete one",
    ),
}

VALUES = {
    "the key's own unit in the value": (
        ("Ti_ms: 0.571", 'Ti_ms: "0.571 ms"'),
        "41: axes.x.inner.Ti_ms: expected a number greater than 0, not the text '0.571 ms': "
        "the key names the unit, write Ti_ms: 0.571",
    ),
    "another unit in the value": (
        ("Ti_ms: 0.571", "Ti_ms: 571 us"),
        "41: axes.x.inner.Ti_ms: expected a number greater than 0, not the text '571 us': "
        "the key names the unit, write the number in milliseconds",
    ),
    "a unit in a list": (
        ("[-20, 150]", "[-20 V, 150]"),
        "16: outputs.voltage_x.range_V[0]: expected a number, not the text '-20 V': the key names the unit, write -20",
    ),
    "a unit where there is none": (
        ("rate_hz: 10000", "rate_hz: 10000\n  priority: 80 %"),
        "5: loop.priority: expected a whole number from 1 to 98, not the text '80 %': "
        "the number goes without a unit, write priority: 80",
    ),
    "decimal comma": (
        ("Td_ms: 0.167", "Td_ms: 0,167"),
        "42: axes.x.inner.Td_ms: expected a number at least 0, not the text '0,167': write Td_ms: 0.167",
    ),
    "not whole": (
        ("rate_hz: 10000", "rate_hz: 1e4"),
        "4: loop.rate_hz: expected a whole number from 100 to 20000, not 10000.0: write rate_hz: 10000",
    ),
    "out of range": (
        ("rate_hz: 10000", "rate_hz: 50000"),
        "4: loop.rate_hz: expected a whole number from 100 to 20000, not 50000",
    ),
    "yes is not true": (
        ("arm_on_start: false", "arm_on_start: yes"),
        "44: arm_on_start: expected true or false, not the text 'yes': write arm_on_start: true",
    ),
    "true is no number": (
        ("centre_um: 65", "centre_um: true"),
        "28: axes.x.centre_um: expected a number, not true",
    ),
    "empty": (
        ("centre_um: 65", "centre_um:"),
        "28: axes.x.centre_um: expected a number, not an empty value",
    ),
    "none is not null": (
        ("max_age_us: null", "max_age_us: none"),
        "12: signals.deviation_x.max_age_us: expected a number greater than 0 or null, not the text 'none': "
        "write max_age_us: null",
    ),
    "number for a name": (
        ("max_age_us: null", "channel: 3"),
        '12: signals.deviation_x.channel: expected text or null, not 3: write channel: "3"',
    ),
    "not one of the choices": (
        ("mode: pid+feedforward", "mode: pid+feedfoward"),
        "39: axes.x.inner.mode: expected pid, pid+feedforward or feedforward, not the text 'pid+feedfoward': "
        "did you mean pid+feedforward?",
    ),
    "no such variant": (
        ("source: sine", "source: sinus"),
        "20: reference.source: expected hold, step, sine, file or signal, not the text 'sinus': did you mean sine?",
    ),
    "another version": (
        ("schema_version: 1", "schema_version: 2"),
        "2: schema_version: expected 1, not 2",
    ),
    "entry of a list": (
        ("[0.1, 0.08, 0.05]", "[0.1, 0.08, high]"),
        "37: axes.x.hysteresis.weights[2]: expected a number, not the text 'high'",
    ),
    "half a pair": (
        ("[-20, 150]", "[150]"),
        "16: outputs.voltage_x.range_V: expected a list of 2 numbers, not a list of 1",
    ),
    "a list without brackets": (
        ("[-20, 150]", "-20, 150"),
        "16: outputs.voltage_x.range_V: expected a list of 2 numbers, not the text '-20, 150': "
        "write range_V: [-20, 150]",
    ),
    "infinite": (
        ("[-20, 150]", "[-20, .inf]"),
        "16: outputs.voltage_x.range_V[1]: expected a finite number, not .inf; where no limit is meant, null says so",
    ),
    "too large for a float": (
        ("centre_um: 65", "centre_um: 1e400"),
        "28: axes.x.centre_um: expected a finite number, not 1e400; where no limit is meant, null says so",
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
    "open bracket": (("[-20, 150]", "[-20, 150"), "16: not YAML: this [ isn't closed"),
    "open quote": (("mode: strain", "mode: 'strain"), "27: not YAML: this quote isn't closed"),
    "no colon": (("      Td_ms: 0.167", "      Td_ms 0.167"), "42: not YAML: no colon after this key"),
    "two colons": (
        ("mode: strain", "mode: strain: 1"),
        "27: not YAML: unexpected colon; check the indentation here and on the line before",
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
        ("driver: simulated", "driver: !!python/name:os.system"),
        "8: drivers.cell.driver: the tag '!!python/name:os.system' isn't known here; leave it out",
    ),
    "tag that doesn't fit": (
        ("centre_um: 65", "centre_um: !!int middle"),
        "28: axes.x.centre_um: the tag !!int needs a whole number, not 'middle'",
    ),
    "alias of itself": (
        ("      range_um: [5, 125]", "      range_um: &range [5, *range]"),
        "30: axes.x.setpoint.range_um[1]: an alias of the section it stands in",
    ),
}


@pytest.mark.parametrize(("change", "expected"), [pytest.param(*case, id=name) for name, case in KEYS.items()])
def test_wrong_key(write, change, expected):
    assert message(write(with_change(*change))) == f"cell.yaml:{expected}"


@pytest.mark.parametrize(("change", "expected"), [pytest.param(*case, id=name) for name, case in VALUES.items()])
def test_wrong_value(write, change, expected):
    assert message(write(with_change(*change))) == f"cell.yaml:{expected}"


@pytest.mark.parametrize(("change", "expected"), [pytest.param(*case, id=name) for name, case in SYNTAX.items()])
def test_wrong_yaml(write, change, expected):
    assert message(write(with_change(*change))) == f"cell.yaml:{expected}"


SECTIONS = "schema_version, loop, start, drivers, signals, outputs, reference, axes, arm_on_start"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", f":1: expected the sections {SECTIONS}; the file holds nothing"),
        ("- 1", f":1: expected the sections {SECTIONS}; the file holds a list"),
        ("\n\nhello", f":3: expected the sections {SECTIONS}; the file holds a single value"),
        (b"a: 1\nb: \xff", ":2: not UTF-8 text (byte 0xff)"),
        (b"a: 1\nb: \0", ":2: character '\\x00' can't stand in YAML"),
        (b"a" * 1_000_001, ": larger than 1000 kB; is it really a configuration?"),
        ("[" * 3000, ":1: nested too deeply"),
        ('a: "\\U99999999"', ":1: not YAML: an escape sequence or a %YAML line with an impossible number"),
    ],
    ids=["empty", "list", "scalar", "binary", "zero byte", "huge", "deep", "escape"],
)
def test_no_configuration_at_all(write, content, expected):
    assert message(write(content)) == f"cell.yaml{expected}"


def test_unreadable_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    assert message(Path("none.yaml")) == "none.yaml: no such file; config/ has examples"
    assert message(Path()) == ".: a directory; name the YAML file in it"
    assert message(Path("loop")) == "loop: can't be read: Too many levels of symbolic links"


def test_aliases_that_expand_without_end(write):
    levels = "\n".join(f"  b{i}: &b{i} [{', '.join([f'*b{i - 1}'] * 10)}]" for i in range(1, 9))
    found = message(write(f"a:\n  b0: &b0 [1]\n{levels}\n"))
    assert re.fullmatch(r"cell.yaml:\d+: a.*: more than 100000 values; aliases are counted where they are used", found)


def test_problems_stand_in_the_order_of_the_file(write):
    text = with_change("arm_on_start: false", "arm_on_start: 1").replace("rate_hz: 10000", "rate_hz: 1")
    assert message(write(text)).splitlines() == [
        "cell.yaml:4: loop.rate_hz: expected a whole number from 100 to 20000, not 1",
        "cell.yaml:44: arm_on_start: expected true or false, not 1",
    ]


def test_only_the_first_ten_problems_are_shown(write):
    unknown = "".join(f"unknown{i}: {i}\n" for i in range(13))
    lines = message(write(TEXT + unknown)).splitlines()
    assert len(lines) == 11
    assert lines[0].startswith("cell.yaml:45: unknown0: unknown key unknown0")
    assert lines[-1] == "cell.yaml: and 3 more"


def test_merge_keys_and_aliases(write):
    setpoint = "\n    setpoint: &shared\n      range_um: [5, 125]"
    second = TEXT[TEXT.index("  x:\n") : TEXT.index("arm_on_start")].replace("  x:", "  y:")
    second = second.replace(setpoint, "\n    setpoint: {<<: *shared, slew_um_per_ms: 3}")
    text = with_change("\n    setpoint:\n      range_um: [5, 125]", setpoint)
    second = second.replace(
        "\n    setpoint:\n      range_um: [5, 125]", "\n    setpoint: {<<: *shared, slew_um_per_ms: 3}"
    )
    axes = load(write(text.replace("arm_on_start", f"{second}arm_on_start"))).axes
    assert axes["y"].setpoint.range_um == axes["x"].setpoint.range_um
    assert axes["y"].setpoint.slew_um_per_ms == 3.0


@pytest.mark.parametrize(
    ("written", "meant"),
    [("1e-3", 1e-3), ("+.5", 0.5), ("1.", 1.0), ("1E+2", 100.0), ("0x10", 16), ("0o10", 8), ("010", 10), ("-7", -7)],
)
def test_numbers_are_those_of_yaml_1_2(write, written, meant):
    assert (
        load(
            write(with_change("park_V: 0", "park_V: 0").replace("offset_um: 0", f"offset_um: {written}"))
        ).reference.offset_um
        == meant
    )


@pytest.mark.parametrize("text", ["on", "no", "y", "12:30", "2026-01-31", "1_000", "=", "0x", "1e", "nan"])
def test_text_stays_text(write, text):
    configuration = load(write(with_change("max_age_us: null", f"channel: {text}")))
    assert configuration.signals["deviation_x"].channel == text


def test_source_points_at_keys(write):
    file = write(TEXT)
    _, source = load_with_source(file)
    assert str(source.error("axes.x.inner.Ti_ms", "too fast")) == "cell.yaml:41: axes.x.inner.Ti_ms: too fast"
    weight = ("axes", "x", "hysteresis", "weights", 2)
    assert str(source.error(weight, "too\nlarge")) == "cell.yaml:37: axes.x.hysteresis.weights[2]: too large"
    assert str(source.error("start.lift_s", "no line of its own")) == "cell.yaml:2: start.lift_s: no line of its own"
    assert str(source.error("axes.x.outer.effort", "absent")) == "cell.yaml:26: axes.x.outer.effort: absent"
    assert source.errors([("loop", "b"), ("schema_version", "a")]).args == (
        "cell.yaml:2: schema_version: a\ncell.yaml:3: loop: b",
    )
    assert source.text == TEXT
    assert source.hash == hashlib.sha256(file.read_bytes()).hexdigest()


class Trace(BaseModel):
    model_config = ConfigDict(extra="forbid")

    kind: Literal["trace"] = "trace"
    level: int = Field(ge=0, le=3)


class CardOptions(BaseModel):
    """A driver's own model, with kinds of fields that the configuration itself doesn't have."""

    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

    seed: int = 0
    bitrate: Literal["auto"] | float = "auto"
    node: str = Field(default="n1", pattern=r"^n\d$")
    log: bool | Trace = False
    opaque: Path | None = None


CARD = {
    "typing error": ("sed: 2", "sed", "unknown key sed: did you mean seed?"),
    "union of plain types": ("bitrate: fast", "bitrate", "expected auto or a number, not the text 'fast'"),
    "a pattern": ("node: x", "node", r"String should match pattern '^n\d$', not the text 'x'"),
    "union with a section": ("log: {level: 9}", "log", "expected a whole number from 0 to 3, not 9"),
}


@pytest.mark.parametrize(("options", "key", "expected"), CARD.values(), ids=CARD)
def test_section_of_a_driver(write, options, key, expected):
    configuration, source = load_with_source(write(with_change("seed: 1", options)))
    with pytest.raises(ConfigError) as caught:
        validate_section(source, ("drivers", "cell"), CardOptions, configuration.drivers["cell"].options)
    lines = str(caught.value).splitlines()
    assert any(re.fullmatch(rf"cell.yaml:8: drivers.cell.{key}(\.\w+)?: {re.escape(expected)}", line) for line in lines)


def test_good_section_of_a_driver(write):
    configuration, source = load_with_source(write(TEXT))
    options = validate_section(source, ("drivers", "cell"), CardOptions, configuration.drivers["cell"].options)
    assert options.seed == 1


def loads_or_explains(file: Path, content: bytes) -> None:
    """Whatever the file holds, the answer is a configuration, or lines of text that a terminal can show."""
    file.write_bytes(content)
    try:
        assert isinstance(load(file), Configuration)
    except ConfigError as error:
        lines = str(error).split("\n")
        assert all(line.startswith(str(file)) and line.encode() and line.isprintable() for line in lines)


@pytest.fixture(scope="module")
def any_file(tmp_path_factory):
    return tmp_path_factory.mktemp("any") / "any.yaml"


@given(content=st.binary() | st.text().map(str.encode))
def test_any_content(any_file, content):
    loads_or_explains(any_file, content)


SCALARS = st.sampled_from(
    [
        "",
        "~",
        "1",
        "-1",
        "1e9",
        "1e999",
        ".nan",
        "true",
        "[]",
        "{}",
        "[[1]]",
        "{a: 1}",
        "*a",
        "&a 1",
        "!!int x",
        "<<",
        "|",
        "? 1",
    ]
)


@given(
    line=st.integers(0, TEXT.count("\n") - 1), value=SCALARS | st.text(max_size=8), place=st.sampled_from([0, 0.5, 1])
)
def test_good_configuration_with_any_change(any_file, line, value, place):
    """One line gets another value, another key, or something in its middle."""
    lines = TEXT.splitlines()
    key, colon, rest = lines[line].partition(": ")
    changed = {0: f"{value}{colon}{rest}", 0.5: f"{key}{value}{colon}{rest}", 1: f"{key}: {value}"}
    lines[line] = changed[place]
    loads_or_explains(any_file, "\n".join(lines).encode())
