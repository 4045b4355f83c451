"""Running values written back: the file means what runs, and looks as it did."""

from pathlib import Path

import pytest

from campaigns.report import CONFIG
from micromanip.errors import ConfigError
from micromanip.settings.load import validate_document
from micromanip.settings.text.keys import assigned
from micromanip.settings.text.source import Source
from micromanip.settings.write import with_values

SIMULATED = CONFIG / "simulated.yaml"
SHARED = """\
schema_version: 2
loop: {rate_hz: 10000, limits: simulation}  # the loop
drivers: {cell: {driver: simulated}}
signals: {strain_x: {driver: cell}, strain_y: {driver: cell}}
outputs:
  voltage_x: {driver: cell, range_V: [-20, 150], slew_V_per_ms: 40}
  voltage_y: {driver: cell, range_V: [-20, 150], slew_V_per_ms: 40}
reference: {source: hold, offset_um: 60}
axes:
  x: &tuned
    mode: strain
    centre_um: 66
    setpoint: {range_um: [2, 128]}
    inner: {mode: pid, K_V_per_um: 0.6, Ti_ms: 0.571, Td_ms: 0.167, filter_ms: 0.3}  # by hand
"""
ALIAS = SHARED + "  y: *tuned\n"
MERGE = SHARED + "  y:\n    <<: *tuned\n    centre_um: 60  # lower\n"


def written(text, **values):
    """`text` with `values` (``__`` for a dot), and the configuration that was meant."""
    source = Source.parse(Path("cell.yaml"), text)
    known = validate_document(source).model_dump(mode="json")
    document = assigned(source.data, known, {key.replace("__", "."): value for key, value in values.items()})
    return with_values(source, document), validate_document(Source.of(document, Path()))


def differing(old, new):
    return [line for line in new.splitlines() if line not in old.splitlines()]


def test_lines_as_somebody_else_wrote_them_stay():
    """Long ones, lists without indentation, quotes, spaces and blanks of their own, trailing ones too."""
    text = SHARED.replace("loop: {", "loop:   { ")
    text += (
        "  y: {mode: 'strain',   centre_um: 66.0, setpoint: {range_um: [2,128]}, inner: {mode: \"pid\", "
        "K_V_per_um: 0.60, Ti_ms: 0.571, Td_ms: 0.167, filter_ms: 0.3}}  \n\n\n# the end\n"
    )
    new, meant = written(text, axes__x__setpoint__range_um=[3.0, 120.0])
    assert differing(text, new) == ["    setpoint: {range_um: [3.0, 120.0]}"]
    assert len(new.splitlines()) == len(text.splitlines())
    assert validate_document(Source.parse(Path("cell.yaml"), new)) == meant


def test_another_kind_of_section():
    text = SIMULATED.read_text()
    new, meant = written(text, axes__y__hysteresis={"model": "none"}, axes__y__inner__mode="pid")
    assert validate_document(Source.parse(SIMULATED, new)) == meant
    assert new.count("thresholds_um") == text.count("thresholds_um") - 1


@pytest.mark.parametrize("text", [ALIAS, MERGE])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_an_axis_that_shares_its_section(text, axis):
    """Only the axis that was meant changes, though the file writes both at once."""
    new, meant = written(text, **{f"axes__{axis}__inner__K_V_per_um": 0.5})
    found = validate_document(Source.parse(Path("cell.yaml"), new))
    assert found == meant
    assert {name: a.inner.K_V_per_um for name, a in found.axes.items()} == {"x": 0.6, "y": 0.6} | {axis: 0.5}
    assert "# by hand" in new


def test_a_file_that_cannot_be_edited_is_refused():
    """A merged key can't be taken away from the section that merges it."""
    text = MERGE.replace(
        "reference: {source: hold, offset_um: 60}", "reference: {<<: {start_s: 1.0}, source: hold, offset_um: 60}"
    )
    source = Source.parse(Path("cell.yaml"), text)
    with pytest.raises(ConfigError, match=r"^cell.yaml: its anchors or merge keys can't be kept"):
        with_values(source, source.data | {"reference": {"source": "hold", "offset_um": 60}})
