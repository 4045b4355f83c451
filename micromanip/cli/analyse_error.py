"""``micromanip analyse error``: what the path error is made of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .echo import echo
from .options import Answer, Quantity, axis_option, chosen_axes, subcommand
from .progress import steps
from .recording_options import open_recording
from .results import out_option, page_in

if TYPE_CHECKING:
    from micromanip.design.analyse.budget.budget import AxisBudget

_CONFIGURATIONS = (".yaml", ".yml")


@subcommand("error", "micromanip analyse error config/simulated.yaml --out out/error")
@click.argument("file", type=click.Path(path_type=Path), metavar="CONFIG|RECORDING")
@axis_option
@click.option(
    "--seconds", type=Quantity("Seconds", least=4.0, most=600.0), default=20.0, metavar="S",
    help="Virtual time that a simulated cell is played for; its noise is told from a force the better, the longer.",
)  # fmt: skip
@click.option("--seed", type=Quantity("Seed"), default=1, help="Of the noise that is played.")
@click.option(
    "--coherence", "coherence_s", type=Quantity("Seconds", least=0.05, most=60.0), default=1.0,
    metavar="S", help="For how long path and force keep their phase: what the bound takes for granted.",
)  # fmt: skip
@out_option("the page error.html")
def command(file: Path, only: str, seconds: float, seed: int, coherence_s: float, folder: Path | None) -> Answer:
    """Variance of the path error by cause, and a bound that no causal controller can beat.

    It is what the signals of a recording show; a configuration (.yaml) of a simulated cell is played in virtual time.
    docs/analyse.md explains it.
    """
    with page_in(folder, "error.html") as page, steps() as bar:
        if file.suffix.lower() in _CONFIGURATIONS:
            budgets, about = _of_configuration(file, only, seconds, seed, coherence_s, bar.say)
        else:
            budgets, about = _of_recording(file, only, coherence_s, bar.say)
        if folder is not None:
            from micromanip.design.analyse.budget.budget import composition

            bar.say("drawing")
            page.write(f"Path error of {about}", map(composition, budgets))
    document = {"file": str(file), "axes": [each.document() for each in budgets], "page": page.name}

    def show() -> None:
        for budget in budgets:
            _print(budget)
        page.echo()

    return Answer(document, show, page.problem)


def _of_configuration(
    file: Path, only: str, seconds: float, seed: int, coherence_s: float, step: Callable[[str], None]
) -> tuple[list[AxisBudget], str]:
    from micromanip.design.analyse.budget.recorded import played_budget
    from micromanip.settings.check import prepare

    prepared = prepare(file, seed)
    axes = chosen_axes(prepared.configuration.axes, only, file)
    return played_budget(prepared, axes, seconds, coherence_s, step), f"{file}, seed {seed}"


def _of_recording(
    file: Path, only: str, coherence_s: float, step: Callable[[str], None]
) -> tuple[list[AxisBudget], str]:
    from micromanip.design.analyse.budget.recorded import recorded_budget

    telemetry = open_recording(file)
    return recorded_budget(telemetry, chosen_axes(telemetry.axes, only, file), coherence_s, step), str(file)


def _print(budget: AxisBudget) -> None:
    from .tables import print_table

    named = [(cause.name, cause.rms_um, cause.variance_um2) for cause in budget.causes]
    print_table(
        ("cause", "um rms", "variance, um^2", "share"),
        (
            (name, f"{rms:.3f}", f"{variance:.5f}", budget.share(variance))
            for name, rms, variance in (*named, ("whole", budget.rms_um, budget.variance_um2))
        ),
        f"Path error of axis {budget.axis}",
    )
    bound = budget.bound
    echo(
        f"by this run's spectra no causal controller leaves less than {bound.rms_um:.3f} um, where phases are known "
        f"for {bound.coherence_s:g} s: the path's share is {bound.path_um2**0.5:.3f} um, the force's "
        f"{bound.force_um2**0.5:.3f} um"
    )
    echo(f"seen in {budget.seen}")
