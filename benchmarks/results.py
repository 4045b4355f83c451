"""What a benchmark hands back: figures beside their references, or the reason why there is none."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


class Skipped(Exception):  # noqa: N818
    """Raised where the machine lacks what a benchmark needs; the text says what, and where to get it."""


@dataclass(frozen=True)
class Result:
    """One figure and its reference; `ratio` is a figure of its own where it is not just their quotient."""

    name: str
    value: float
    unit: str
    reference_name: str
    reference_value: float
    ratio: float

    @classmethod
    def of(cls, name: str, value: float, unit: str, reference_name: str, reference_value: float) -> Result:
        """The plain quotient as the ratio."""
        return cls(name, value, unit, reference_name, reference_value, value / reference_value)


@dataclass
class Report:
    """Everything that one ``micromanip system bench`` found out."""

    results: list[Result] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """As ``system bench --json`` prints it, four digits."""
        return {
            "results": [{k: _rounded(v) for k, v in asdict(result).items()} for result in self.results],
            "skipped": [{"name": name, "reason": reason} for name, reason in self.skipped.items()],
            "failed": [{"name": name, "reason": reason} for name, reason in self.failed.items()],
        }


def _rounded(value: Any) -> Any:
    return float(f"{value:.4g}") if isinstance(value, float) else value
