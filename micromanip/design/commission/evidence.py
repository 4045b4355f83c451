"""What commissioning an axis leaves behind for people: verdicts, figures and plots, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..criterion import Criterion
from ..plot import Plot


@dataclass(frozen=True)
class Table:
    """Rows of text below their heads; the first of each row names it."""

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Section:
    """A step of the commissioning: what was done in words, figures by name, tables, its plots."""

    title: str
    text: str
    figures: dict[str, str] = field(default_factory=dict)
    plots: tuple[Plot, ...] = ()
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True)
class Evidence:
    """Everything about one axis."""

    axis: str
    criteria: tuple[Criterion, ...]
    sections: tuple[Section, ...]

    @property
    def passed(self) -> bool:
        """Whether no criterion fails."""
        return all(criterion.passed for criterion in self.criteria)

    @property
    def proven(self) -> bool:
        """Whether none fails but for accuracy: such an axis may run."""
        return all(criterion.passed or criterion.acceptance for criterion in self.criteria)
