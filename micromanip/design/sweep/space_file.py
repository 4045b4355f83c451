"""What is varied, as a file of YAML instead of options."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from micromanip.settings.load import validate_section
from micromanip.settings.text.source import Source

from .space import Dimension


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Ends(_Section):
    """Between what a key is drawn."""

    low: float
    high: float
    log: bool = False


class SpaceFile(_Section):
    """Keys of a configuration, ``axes.*.`` for every axis alike, with their ends."""

    vary: dict[str, Ends] = Field(min_length=1)


def read_dimensions(file: Path) -> tuple[Dimension, ...]:
    """What a file of a space varies; ConfigError with file, line and key of what is wrong."""
    source = Source.read(file)
    found = validate_section(source, (), SpaceFile, source.data)
    for key, ends in found.vary.items():
        if not ends.low < ends.high:
            raise source.error(("vary", key, "high"), f"must be above low, {ends.low:g}")
        if ends.log and ends.low <= 0.0:
            raise source.error(("vary", key, "low"), "a logarithm begins above 0")
    return tuple(
        Dimension(key, ends.low, ends.high, ends.log, f"{file}:{source.lines[('vary', key)]}:")
        for key, ends in found.vary.items()
    )
