"""The table of reactions in docs/safety.md has the limits that the schema has: set `hardware`, no number by heart."""

import re
from pathlib import Path

import pytest

from micromanip.faults import BY_NAME
from micromanip.settings.schema.faults import SWING_S, SWINGS, Faults

PAGE = Path(__file__).parents[2] / "docs" / "safety.md"
FAULTS = Faults()
AXIS = FAULTS.axis
NUMBER = re.compile(r"(?<![\w.-])\d+(?:\.\d+)?")
LIMITS = {
    "strain gauge not finite": (f"{AXIS.strain.samples} samples:", f"{AXIS.strain.coast_ms:g} ms without feedback"),
    "strain gauge silent": (),
    "strain gauge stuck": (f"{AXIS.strain.identical} samples:", f"{AXIS.strain.coast_ms:g} ms without feedback"),
    "capacitive sensor unusable": (f"{AXIS.stage.samples} samples", f"{AXIS.stage.degraded_s:g} s on the prediction"),
    "capacitive sensor off": (),
    "swings from end to end": (f"{SWINGS} times in {SWING_S:g} s",),
    "a bus takes its outputs": (),
    "path error above its limit": (f"{AXIS.following_error.time_ms:g} ms",),
    "voltage at its end": (f"{AXIS.saturation.warn_ms:g} ms warning", f"{AXIS.saturation.time_ms:g} ms |"),
    "inner loop oscillates": (f"{AXIS.oscillation.time_ms:g} ms",),
    "reference late": (f"{AXIS.reference.stale_periods:g} periods",),
    "reference lost": (f"{AXIS.reference.time_ms:g} ms", f"in {AXIS.reference.decay_ms:g} ms"),
    "one bad sample": (),
    "amplifier fault": (),
    "amplifier hot": (
        {50.0: "half the correction"}[AXIS.over_temperature.derate_percent],
        f"after {AXIS.over_temperature.time_s:g} s",
    ),
    "guard opened": (),
    "a wire of `enable` broken": (),
    "three deadlines missed": (
        f"{ {3: 'three'}[FAULTS.deadline.in_a_row] } deadlines",
        f"{FAULTS.deadline.share_percent:g} %",
    ),
    "host dead": (f"{FAULTS.host.silent_ms:g} ms",),
}
"""Beginning of a row, and what of it is a limit."""
MEASURED = {
    "strain gauge not finite": {"0.2"},
    "strain gauge silent": {"0.5"},
    "strain gauge stuck": {"1.9"},
    "capacitive sensor off": {"3", "0.1", "0.3", "10", "22"},
    "one bad sample": {"3"},
    "amplifier fault": {"0"},
    "amplifier hot": {"0"},
    "guard opened": {"0"},
    "a wire of `enable` broken": {"0.3"},
}
"""Numbers of a row that tests/virtual/test_safety.py measures, or that are part of the experiment."""
REACTIONS = {"hold": "hold", "ramp": "ramp", "off": "amplifier off"}


def rows():
    table = PAGE.read_text(encoding="utf-8").split("| injected |")[1].split("\n\n")[0]
    return [line for line in table.splitlines()[2:] if line.startswith("|")]


def named(row):
    (name,) = [name for name in LIMITS if row.startswith(f"| {name}")]
    return name


def test_every_row_is_known():
    assert sorted(map(named, rows())) == sorted(LIMITS)


@pytest.mark.parametrize("row", rows(), ids=named)
def test_a_row_has_the_limits_of_the_schema_and_no_other_number(row):
    limits = LIMITS[named(row)]
    rest = re.sub(r"\]\([^)]*\)", "]", row)
    for limit in limits:
        assert limit in rest, f"{limit!r} is the default"
        rest = rest.replace(limit, "")
    assert set(NUMBER.findall(rest)) <= MEASURED.get(named(row), set())


@pytest.mark.parametrize("row", rows(), ids=named)
def test_a_row_has_the_reaction_of_the_schema(row):
    kinds = {kind.code: kind for kind in BY_NAME.values()}
    for code in re.findall(r"X-\d+", row.split("|")[3]):
        section = FAULTS
        for part in filter(None, kinds[code].section.split(".")):
            section = getattr(section, part)
        reaction = getattr(section, "reaction", "ramp")
        assert REACTIONS[reaction] in row.split("|")[3], f"{code} is answered with {reaction}"
