"""What is said of a key at its field, beside type, unit, bounds and meaning: what a change of it takes, and which way
it protects less.

``slew_um_per_ms: Live[Speed] = Field(...)``. What is said of a section counts for each key in it that has no word of
its own. It becomes part of the model's JSON schema, where `Shape` reads it: for ``set``, and for the reference in docs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from pydantic import GetJsonSchemaHandler

LIVE, DISARM, RESTART = "live", "needs disarm", "needs restart"
LARGER, SMALLER, WIDER, NARROWER, NEITHER = "larger", "smaller", "wider", "narrower", "neither"


@dataclass(frozen=True)
class Said:
    """A word of `Shape.said`, with its value."""

    word: str
    value: str

    def __get_pydantic_json_schema__(self, core: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """The schema of the field, with the word in it."""
        return {**handler(core), self.word: self.value}


Type = TypeVar("Type")

Live = Annotated[Type, Said("change", LIVE)]
"""Applied at a cycle boundary while tracking."""
AtRest = Annotated[Type, Said("change", DISARM)]
"""Applied with the outputs at rest only."""
NewStart = Annotated[Type, Said("change", RESTART)]
"""Read when the controller starts."""

LargerIsWeaker = Annotated[Type, Said("weaker", LARGER)]
"""A larger value protects less; null is no limit at all, and a milder reaction is the weaker one."""
SmallerIsWeaker = Annotated[Type, Said("weaker", SMALLER)]
WiderIsWeaker = Annotated[Type, Said("weaker", WIDER)]
NarrowerIsWeaker = Annotated[Type, Said("weaker", NARROWER)]
NeverWeaker = Annotated[Type, Said("weaker", NEITHER)]
"""It says how a reaction is carried out, not whether."""
