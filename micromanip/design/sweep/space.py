"""What is varied, and the values of each tuning: drawn of a seed and the tuning's number alone, whoever asks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from micromanip.errors import UsageError
from micromanip.settings.load import validate_section
from micromanip.settings.text.digits import rounded
from micromanip.settings.text.source import Source

_EVERY = "axes.*."


@dataclass(frozen=True)
class Dimension:
    """A key with the ends between which it is drawn evenly, over its logarithm where `log`."""

    key: str
    low: float
    high: float
    log: bool = False
    origin: str = field(default="--vary", compare=False)
    """What messages about it begin with: the option, or file and line."""

    @classmethod
    def parse(cls, text: str) -> Dimension:
        """Of ``KEY=LOW:HIGH`` or ``KEY=LOW:HIGH:log``; raises UsageError."""
        key, _, span = text.partition("=")
        low, *rest = span.split(":")
        try:
            ends = float(low), float(rest[0])
            log = rest[1:] == ["log"]
            good = key.strip() == key != "" and (log or not rest[1:]) and -math.inf < ends[0] < ends[1] < math.inf
        except (ValueError, IndexError):
            good = False
        if not good:
            raise UsageError(
                f"--vary {text!r:.80}: write KEY=LOW:HIGH or KEY=LOW:HIGH:log, axes.x.inner.Ti_ms=0.05:0.5:log; "
                "axes.*. is every axis alike"
            )
        if log and ends[0] <= 0.0:
            raise UsageError(f"--vary {text!r:.80}: a logarithm begins above 0")
        return cls(key, *ends, log)

    def value(self, share: float) -> float:
        """The value at `share` (0..1) of the way."""
        if self.log:
            return float(math.exp(math.log(self.low) + share * math.log(self.high / self.low)))
        return self.low + share * (self.high - self.low)

    def __str__(self) -> str:
        return f"{self.key}={self.low:g}:{self.high:g}{':log' if self.log else ''}"


@dataclass(frozen=True)
class Space:
    """All that is varied, and the seed. Tuning 0 is the base itself: it shows what there is to win."""

    dimensions: tuple[Dimension, ...]
    seed: int

    def __post_init__(self) -> None:
        keys = [dimension.key for dimension in self.dimensions]
        if twice := next((each for each in reversed(self.dimensions) if keys.count(each.key) > 1), None):
            raise UsageError(f"{twice.origin} {twice.key} is given twice")

    def values(self, number: int) -> dict[str, float]:
        """Key -> value of tuning `number`, rounded as they are written to a file; empty for the base."""
        if number == 0:
            return {}
        shares = np.random.default_rng([self.seed, number]).random(len(self.dimensions))
        return {each.key: rounded(each.value(share)) for each, share in zip(self.dimensions, shares, strict=True)}


def for_axes(values: Mapping[str, Any], axes: Sequence[str]) -> dict[str, Any]:
    """Each ``axes.*.`` as the axes' own keys."""
    spread: dict[str, Any] = {}
    for key, value in values.items():
        names = [f"axes.{axis}.{key.removeprefix(_EVERY)}" for axis in axes] if key.startswith(_EVERY) else [key]
        spread |= dict.fromkeys(names, value)
    return spread


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
