"""A key path in the file together with what belongs there: where a pydantic error is, as the user sees it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from .shape import Shape

Path = tuple[str | int, ...]
Finding = tuple[Path, str]
"""What is to be said of a key, and the key."""


@dataclass(frozen=True)
class Place:
    """A shape together with its key path in the file, and the place around it."""

    path: Path
    shape: Shape
    parent: Place | None = None

    def down(self, part: str | int) -> Place:
        """The place at a key or an index."""
        return Place((*self.path, part), self.shape.child(part), self)

    def variant(self, tag: str) -> Place | None:
        """The alternative of a union that pydantic names by its tag or by its class; it has the same key path."""
        key = self.shape.discriminator
        for shape in self.shape.variants:
            if tag in map(str, shape.fields[key].choices) if key else shape.title and shape.title in tag:
                return Place(self.path, shape, self)
        return None


def locate(root: Place, location: Iterable[str | int]) -> Place:
    """Place of a pydantic error; its location also holds the tags of unions, which aren't keys of the file."""
    place = root
    for part in location:
        if place.shape.variants:
            if (variant := place.variant(str(part))) is None:
                return place  # a plain value of a union: what is wrong is said of the union
            place = variant
        elif part != "[key]":  # pydantic's mark for an error in the key itself
            place = place.down(part)
    return place
