"""What a campaign is asked, and the report that it hands back: printed as tables, as JSON, or as a page."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
CONFIG, CONFIGURATIONS = ROOT / "config", ROOT / "campaigns" / "configurations"


class Asked(Namespace):
    """What was typed (``python -m campaigns --help``), and a `folder` to work in."""

    def tell(self, line: str) -> None:
        """Progress, for people."""
        sys.stderr.write(line + "\n")
        sys.stderr.flush()


@dataclass
class Report:
    """Tables by their titles, a mapping of column and value for each row; `wrong` says what must not have been."""

    tables: dict[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """In Markdown."""
        parts = [f"## {title}\n\n{table(rows)}" for title, rows in self.tables.items()]
        for title, lines in (("Notes", self.notes), ("Wrong", self.wrong)):
            if lines:
                parts.append(f"## {title}\n\n" + "".join(f"- {line}\n" for line in lines))
        return "\n".join(parts)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A table in Markdown; a column that a row lacks is left open."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    lines = [columns, ["---"] * len(columns), *([_cell(row.get(column)) for column in columns] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _cell(value: Any) -> str:
    if value is None or value != value:
        return ""
    return f"{value:.3f}" if isinstance(value, float) else str(value).replace("|", "\\|").replace("\n", " ")
