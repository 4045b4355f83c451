"""What ``micromanip commission`` has found: written into its folder, and told, as JSON or to people."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micromanip.errors import MicromanipError, system_error

from .echo import echo
from .results import keep, publish

if TYPE_CHECKING:
    from micromanip.design.commission.cell import CommissionedCell
    from micromanip.settings.check import Prepared
    from micromanip.settings.schema.axis import Axis

REPORT, TUNED, PREVIOUS, REJECTED = "report.html", "tuned.yaml", "previous.yaml", "rejected.yaml"


def write_results(
    prepared: Prepared, found: CommissionedCell, facts: dict[str, str], folder: Path, run: Path
) -> tuple[dict[str, Axis], MicromanipError | None]:
    """Write tuning and report into `run`, and copies into `folder`; the axes with their notes, and what is missing.

    The tuning comes first: it is small, and what the axis was moved for. Raises where even that finds no room. One that
    is not proven is not called tuned.
    """
    from micromanip.design.commission.report import write_report
    from micromanip.design.commission.written import tuned_text
    from micromanip.design.report.model import missed
    from micromanip.settings.schema.axis import Commissioned
    from micromanip.settings.tuning_hash import tuning_hash
    from micromanip.settings.write import write_atomically

    today = facts["time"][:10]
    axes = {each.axis: found.configuration.axes[each.axis] for each in found.axes}
    hashes = {name: tuning_hash(axis) for name, axis in axes.items()}
    stories = {story.axis: story for story in found.evidence}
    noted = {
        name: axis.model_copy(
            # the run's own, from where the tuning is copied to: the report there may be of another axis by tomorrow
            update={
                "commissioned": Commissioned(
                    hash=hashes[name], report=f"{run.name}/{REPORT}", date=today, less=missed(stories[name])
                )
            }
        )
        for name, axis in axes.items()
    }
    tuned = tuned_text(prepared, found.configuration, noted)
    named = TUNED if found.proven else REJECTED
    if found.axes:
        keep(lambda file: write_atomically(file, tuned), run / named)
    missing = None
    steps: tuple[Callable[[], None], ...] = (
        lambda: write_report(run / REPORT, "Commissioning report", facts, found.evidence, hashes),
        lambda: publish(folder, run, (PREVIOUS, REPORT, TUNED, REJECTED)),
    )
    for step in steps:
        try:
            step()
        except OSError as problem:
            missing = missing or system_error(problem)
    return noted, missing and type(missing)(f"not everything is written, the tuning is {run / named}: {missing}")


def document(found: CommissionedCell, axes: dict[str, Axis], folder: Path, run: Path, seconds: float) -> dict[str, Any]:
    """What was found, for ``--json``; `seconds` is what it took."""
    from dataclasses import asdict

    from micromanip.design.report.model import of_axis, overall

    return {
        "passed": found.passed,
        "verdict": overall(found.evidence).value,
        "seconds": seconds,
        "tuned": str(folder / TUNED) if found.proven else None,
        "rejected": str(folder / REJECTED) if found.axes and not found.proven else None,
        "stopped": None if found.stopped is None else str(found.stopped),
        "report": str(folder / REPORT),
        "run": str(run),
        "production": found.production_document(),
        "coupling": None if found.coupled is None else found.coupled.document(),
        "axes": {
            story.axis: {
                "passed": story.passed,
                "verdict": of_axis(story).value,
                "hash": getattr(axes[story.axis].commissioned, "hash", None) if story.axis in axes else None,
                "criteria": [asdict(criterion) for criterion in story.criteria],
            }
            for story in found.evidence
        },
    }


def print_found(found: CommissionedCell, folder: Path, run: Path, seconds: float) -> None:
    """What was found, to people, and what to do next."""
    from micromanip.design.report.model import Verdict, of_axis

    from .analyse_margins import print_criteria
    from .tables import out_console

    for story in found.evidence:
        missed = [criterion for criterion in story.criteria if not criterion.passed]
        met = [criterion for criterion in story.criteria if criterion.passed]
        print_criteria(missed, "Not met")
        verdict, colour = of_axis(story), {Verdict.PASS: "green", Verdict.LESS: "yellow"}
        styled = f"[{colour.get(verdict, 'red')}]{verdict.value}[/]"
        out_console().print(f"axis {story.axis}: {styled}, {len(met)} of {len(story.criteria)} criteria are met")
        for criterion in met:
            echo(f"  {criterion.name}: {criterion.value}")
    if found.proven:
        echo(f"{seconds:.0f} s; tuning in {folder / TUNED}, report in {folder / REPORT}; nothing was applied")
    else:
        echo(f"{seconds:.0f} s; no tuning to run, report in {folder / REPORT}; nothing was applied")
    echo(f"this run's files stay in {run}")
    if found.proven:
        for line in _how_it_runs(found):
            echo(line)
        echo(f"next: micromanip check {folder / TUNED}")


def _how_it_runs(found: CommissionedCell) -> list[str]:
    production = found.production
    if production is None:
        return []
    said = [] if found.coupled is None else list(found.coupled.decided)
    if production.obstacle is not None:
        return [f"it does not track yet: {production.obstacle}"]
    errors = ", ".join(f"{name} {seen.rms:.2f}" for name, seen in production.seen.items())
    lines = [*production.decided, *said, f"it tracks, tried as it will run: path error {errors} um rms"]
    if production.budgets:
        most = ", ".join(
            f"{name} {each.causes[0].name} {each.causes[0].rms_um:.2f}" for name, each in production.budgets.items()
        )
        lines.append(f"most of it: {most} um rms; the report has the rest of the error budget")
    return lines
