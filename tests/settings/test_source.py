"""What other modules build on: errors at a key of the file, and sections that a driver has a model of its own for."""

from pathlib import Path
from typing import Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field

from micromanip.errors import ConfigError
from micromanip.settings.load import load_with_source, validate_section


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("axes.x.inner.Ti_ms", "41: axes.x.inner.Ti_ms"),
        (("axes", "x", "hysteresis", "weights", 2), "37: axes.x.hysteresis.weights[2]"),
        ("axes.x.outer.control_weight", "26: axes.x.outer.control_weight"),  # not in the file: the section around it
        (("axes", "a\tb"), "25: axes.'a\\tb'"),
        ("start.lift_s", "2: start.lift_s"),
    ],
)
def test_error_at_a_key(cell, path, expected):
    _, source = load_with_source(cell.write(cell.text))
    assert str(source.error(path, "too\nfast")) == f"cell.yaml:{expected}: too fast"


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
    gains: tuple[float, float] = Field(default=(1.0, 1.0), strict=True)


def options_of(cell, written):
    configuration, source = load_with_source(cell.write(cell.with_change("seed: 1", written)))
    return validate_section(source, ("drivers", "cell"), CardOptions, configuration.drivers["cell"].options)


def test_good_section_of_a_driver(cell):
    options = options_of(cell, "log: {level: 2}, gains: [1, 2]")
    assert options.log == Trace(level=2)
    assert options.gains == (1.0, 2.0)  # YAML has no tuples: a strict one takes a list


CARD = {
    "typing error": ("sed: 2", "sed: unknown key sed: did you mean seed?"),
    "union of plain types": ("bitrate: fast", "bitrate: expected auto or a number, not the text 'fast'"),
    "a pattern": ("node: x", r"node: String should match pattern '^n\d$', not the text 'x'"),
    "a section of a union": ("log: {level: 9}", "log.level: expected a whole number from 0 to 3, not 9"),
}


@pytest.mark.parametrize(("written", "expected"), CARD.values(), ids=CARD)
def test_broken_section_of_a_driver(cell, written, expected):
    with pytest.raises(ConfigError) as caught:
        options_of(cell, written)
    assert str(caught.value) == f"cell.yaml:8: drivers.cell.{expected}"
