"""What commissioning an axis leaves behind for people: verdicts and sections, as plain data."""

from __future__ import annotations

from dataclasses import dataclass

from ..criterion import Criterion
from ..report.model import Section


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
