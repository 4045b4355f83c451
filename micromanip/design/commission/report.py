"""The report of a commissioning: one HTML file that needs nothing else, on a screen, a phone or paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from itertools import count
from pathlib import Path
from string import Template

from micromanip.settings.write import write_atomically

from . import page, verdict
from .evidence import Evidence


def write_report(
    file: Path,
    title: str,
    facts: Mapping[str, str],
    axes: Sequence[Evidence],
    hashes: Mapping[str, str],
) -> None:
    """Write `file`, whole or not at all: the verdict, then the evidence of each of `axes`.

    `facts` are names and values that stand below the verdict (time, configuration, version), `hashes` the
    :func:`~micromanip.settings.tuning_hash.tuning_hash` of each axis by name. The same arguments make the same bytes.
    Raises OSError where the file can't be written,
    ValueError where a curve's x and y differ in length.
    """
    write_atomically(file, _rendered(title, facts, axes, hashes))


def _rendered(
    title: str,
    facts: Mapping[str, str],
    axes: Sequence[Evidence],
    hashes: Mapping[str, str],
) -> str:
    found, numbers = verdict.overall(axes), count(1)
    return Template(_template("report.html")).substitute(
        title=escape(title),
        style=_template("report.css"),
        badge=page.badge(found),
        kind=found.name.lower(),
        sentence=escape(verdict.sentence(axes)),
        facts=page.facts(facts),
        axes_table=page.axes_table(axes, hashes),
        criteria="".join(page.criteria_table(evidence) for evidence in axes if evidence.criteria),
        parts="".join(page.axis_part(evidence, hashes.get(evidence.axis), numbers) for evidence in axes),
        script=_template("report.js"),
    )


def _template(name: str) -> str:
    return (files(__package__) / "templates" / name).read_text(encoding="utf-8")
