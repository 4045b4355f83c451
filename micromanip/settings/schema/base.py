"""Base of all configuration models: strict types, no unknown keys, units in the key's name."""

from __future__ import annotations

import itertools
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class Settings(BaseModel):
    """A section of the configuration file; frozen once validated."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Flag = Annotated[bool, Field(strict=True)]


def is_rising(values: tuple[float, ...]) -> bool:
    """True where each value is larger than the one before."""
    return all(later > earlier for earlier, later in itertools.pairwise(values))
