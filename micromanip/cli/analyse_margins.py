"""``micromanip analyse margins``: describing function, margins and robustness of the axes, with a verdict."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import CheckFailed

from .echo import echo
from .options import Answer, Quantity, axis_option, chosen_axes, config_argument, subcommand
from .progress import steps
from .results import out_option, page_in, provenance

if TYPE_CHECKING:
    from micromanip.design.commission.coupled import Coupled
    from micromanip.settings.check import Prepared


@subcommand("margins", "micromanip analyse margins config/simulated.yaml --axis x --out out/analyse")
@config_argument
@out_option("the page margins.html")
@axis_option
@click.option("--samples", type=click.IntRange(0, 1_000_000), default=100, help="Plants that are drawn, an axis.")
@click.option("--seed", type=Quantity("Seed"), default=1, help="Seed of the first plant; the next follow.")
@click.option("--jobs", type=click.IntRange(1, 1024), show_default="one a CPU", help="Processes that share the plants.")
def command(config: Path, folder: Path | None, only: str, samples: int, seed: int, jobs: int | None) -> Answer:
    """Judge the control of each axis before it runs: is the inverse regular, are the loops stable, with what margin?

    A simulated cell's actuator is recorded in virtual time; on real hardware nothing moves, and the strain loop is
    not judged. Exit code 1 where a criterion fails. docs/analyse.md explains the figures.
    """
    from micromanip.design.analyse.axis import analyse_axis
    from micromanip.design.validate.criteria import criteria, notes, report
    from micromanip.settings.check import prepare
    from micromanip.virtual.experiment import VirtualExperiment

    prepared = prepare(config)
    shown = chosen_axes(prepared.configuration.axes, only, config)
    seeds = range(seed, seed + samples)
    analyses = []
    with page_in(folder, "margins.html") as page, steps() as bar:
        for name in shown:

            def progress(what: str, axis: str = name) -> None:
                bar.say(f"axis {axis}: {what}")

            experiment = VirtualExperiment(prepared) if prepared.wiring.virtual else None
            found = analyse_axis(prepared.configuration, name, experiment, seeds, jobs=jobs or -1, progress=progress)
            analyses.append(found)
        if folder is not None:
            from micromanip.design.plots.loops import analysis_sections

            bar.say("drawing")
            sections = (analysis_sections(each, provenance(prepared, each.axis, seed)) for each in analyses)
            page.write(f"Margins of {config}", chain.from_iterable(sections))
    judged = [criterion for analysis in analyses for criterion in criteria(analysis)]
    coupled = _coupled(prepared, seed) if only == "all" else None
    if coupled is not None:
        judged += [coupled.criterion(name) for name in shown]
    failed = [criterion for criterion in judged if not criterion.passed]
    document = {
        "passed": not failed,
        "axes": [report(analysis) for analysis in analyses],
        "coupling": None if coupled is None else coupled.document(),
        "page": page.name,
    }

    def show() -> None:
        print_criteria(judged, "Analysis")
        if coupled is not None:
            _print_coupling(coupled)
        for analysis in analyses:
            for line in notes(analysis):
                echo(f"axis {analysis.axis}: {line}")
        page.echo()

    return Answer(document, show, page.problem or _failure(judged, failed))


def _failure(judged: list[Any], failed: list[Any]) -> CheckFailed | None:
    if not failed:
        return None
    worst = failed[0]
    return CheckFailed(
        f"{len(failed)} of {len(judged)} criteria fail, the first: axis {worst.axis}, {worst.name}: {worst.value} "
        f"(wanted: {worst.limit})"
    )


def _coupled(prepared: Prepared, seed: int) -> Coupled | None:
    """The coupling of a simulated cell's axes, measured in virtual time; None of any other, or one that is untuned."""
    from micromanip.design.commission.coupled import look_at_coupling
    from micromanip.virtual.experiment import VirtualExperiment

    axes = prepared.configuration.axes.values()
    if not prepared.wiring.virtual or len(axes) < 2 or any(axis.outer is None for axis in axes):
        return None
    return look_at_coupling(prepared.configuration, VirtualExperiment(prepared), seed)


def _print_coupling(coupled: Coupled) -> None:
    """A line per pair of axes."""
    from .tables import print_table

    columns = ("axis", "sees of", "at rest", "at most, over frequency", "gauge", "relative gain")
    print_table(columns, coupled.rows(), "Coupling of the stages")


def print_criteria(judged: list[Any], title: str) -> None:
    """A line a criterion."""
    from .tables import print_table

    rows = (
        (each.axis, each.name, each.value, each.limit, "[green]PASS[/]" if each.passed else "[red]FAIL[/]")
        for each in judged
    )
    print_table(("axis", "criterion", "found", "wanted", ""), rows, title)
