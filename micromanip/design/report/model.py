"""Sections of a report with tables and plots, as plain data.

Plots are numbers, not pictures: the script of a page draws them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

from micromanip.control.system import Array


@dataclass(frozen=True)
class Criterion:
    """``name`` of what was judged, whether it ``passed``, the ``value`` found and the ``limit`` in words.

    ``acceptance``: it asks for accuracy alone; an axis that misses it is less good, and no less safe.
    """

    axis: str
    name: str
    passed: bool
    value: str
    limit: str
    acceptance: bool = False


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


class Verdict(Enum):
    """The word that stands in the report."""

    PASS = "PASS"
    LESS = "PASS WITH LESS"
    FAIL = "FAIL"
    NONE = "NOT JUDGED"


def of_axis(evidence: Evidence) -> Verdict:
    """Of one axis: without any criterion it is not judged, which is no pass; less accurate than asked is one."""
    if not evidence.criteria:
        return Verdict.NONE
    if evidence.passed:
        return Verdict.PASS
    return Verdict.LESS if evidence.proven else Verdict.FAIL


def overall(axes: Sequence[Evidence]) -> Verdict:
    """Of all axes: one failure fails, and nothing passes while an axis is not judged."""
    found = {of_axis(evidence) for evidence in axes} or {Verdict.NONE}
    order = (Verdict.FAIL, Verdict.NONE, Verdict.LESS, Verdict.PASS)
    return next(verdict for verdict in order if verdict in found)


def missed(evidence: Evidence) -> str | None:
    """The accuracy that was asked for and not reached, in words; None where there is none."""
    names = [f"{c.name}: {c.value}" for c in evidence.criteria if c.acceptance and not c.passed]
    return "; ".join(names) or None


def sentence(axes: Sequence[Evidence]) -> str:
    """The verdict in words: how many criteria, which failed, which axis has none."""
    every = [criterion for evidence in axes for criterion in evidence.criteria]
    failed = [f"axis {e.axis}: {c.name}" for e in axes for c in e.criteria if not c.passed]
    unjudged = [evidence.axis for evidence in axes if not evidence.criteria]
    said = f"{len(every) - len(failed)} of {len(every)} criteria are met"
    if failed:
        said += f"; not met: {'; '.join(failed)}"
    if unjudged:
        said += f"; without any criterion: axis {', '.join(unjudged)}"
    return said + "."


@dataclass(frozen=True)
class Curve:
    """One curve: `x` (n,), `y` (n,); `marks` draws points instead of a line, with a text each where there are `texts`.

    `faint` is what should not be relied on.
    """

    label: str
    x: Array
    y: Array
    marks: bool = False
    faint: bool = False
    texts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plot:
    """One pair of axes with its curves; `note` says in a sentence what to look for."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    note: str = ""
    log_x: bool = False
    log_y: bool = False
    equal: bool = False
    """One unit is as long in both directions (Nyquist)."""


@dataclass(frozen=True)
class Table:
    """Rows of text below their heads; the first of each row names it. One that is `folded` opens at a click."""

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    folded: bool = False


@dataclass(frozen=True)
class Section:
    """What was done in words, figures by name, tables, its plots; a `listing` opens at a click."""

    title: str
    text: str
    figures: dict[str, str] = field(default_factory=dict)
    plots: tuple[Plot, ...] = ()
    tables: tuple[Table, ...] = ()
    listing: str = ""
