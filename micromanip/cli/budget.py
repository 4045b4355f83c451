"""``micromanip budget``: what the path error is made of."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .axes import axis_option, chosen_axes
from .options import Quantity, StrictCommand, json_option, print_json
from .prose import say
from .results import out_option

if TYPE_CHECKING:
    from micromanip.design.budget.budget import AxisBudget

_CONFIGURATIONS = (".yaml", ".yml")


@click.command(
    "budget",
    cls=StrictCommand,
    epilog="Example: micromanip budget config/simulated.yaml --out out/budget     or: micromanip budget run.mcap",
)
@click.argument("file", type=click.Path(path_type=Path), metavar="CONFIG|RECORDING")
@axis_option
@click.option(
    "--seconds", type=Quantity("SecondsOrZero", most=600.0), default=10.0, show_default=True, metavar="S",
    help="Virtual time that a simulated cell is played for; 0: not at all.",
)  # fmt: skip
@click.option("--seed", type=Quantity("Seed"), default=1, show_default=True, help="Of the noise that is played.")
@click.option(
    "--coherence", "coherence_s", type=Quantity("Seconds", least=0.05, most=60.0), default=1.0, show_default=True,
    metavar="S", help="For how long path and force keep their phase: what the bound takes for granted.",
)  # fmt: skip
@out_option("pictures", metavar="DIR")
@json_option
def command(
    file: Path, only: str, seconds: float, seed: int, coherence_s: float, folder: Path | None, as_json: bool
) -> None:
    """Variance of the path error by cause; a bound that no causal controller can beat; what other sensors would give.

    Of a configuration (.yaml) it is computed from the models; a simulated cell is also played, in virtual time, for
    what no linear model shows. Of a recording it is what the recorded signals show. docs/budget.md explains it.
    """
    from rich.console import Console
    from rich.progress import Progress

    from .results import Pictures

    with Pictures(folder) as pictures, Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("budget", total=None)

        def step(what: str) -> None:
            bar.update(task, description=what)

        if file.suffix.lower() in _CONFIGURATIONS:
            budgets, about = _of_configuration(file, only, seconds, seed, coherence_s, step)
        else:
            budgets, about = _of_recording(file, only, coherence_s, step)
        if folder is not None:
            from micromanip.design.budget.picture import draw_budget

            step("drawing")
            for budget in budgets:
                pictures.draw(partial(draw_budget, budget, about=about))
        written = pictures.put()
    if as_json:
        print_json(
            {"file": str(file), "axes": [each.document() for each in budgets], "files": [str(f) for f in written]}
        )
    else:
        for budget in budgets:
            _print(budget)
        for picture in written:
            say(f"wrote {picture}")
    pictures.require_written()


def _of_configuration(
    file: Path, only: str, seconds: float, seed: int, coherence_s: float, step: Callable[[str], None]
) -> tuple[list[AxisBudget], str]:
    from micromanip.design.budget.configured import budget_of
    from micromanip.settings.check import prepare

    prepared = prepare(file, seed)
    axes = chosen_axes(prepared.configuration.axes, only, file)
    return budget_of(prepared, axes, seconds, seed, coherence_s, step), f"{file}, seed {seed}"


def _of_recording(
    file: Path, only: str, coherence_s: float, step: Callable[[str], None]
) -> tuple[list[AxisBudget], str]:
    from micromanip.design.budget.recorded import recorded_budget
    from micromanip.recordings import open_telemetry

    telemetry = open_telemetry(file)
    return recorded_budget(telemetry, chosen_axes(telemetry.axes, only, file), coherence_s, step), str(file)


def _print(budget: AxisBudget) -> None:
    from micromanip.design.budget.budget import percent

    from .tables import Figures, out_console

    console = out_console()
    found = budget.document()
    of = "What is known of the path error" if budget.unknown else "Path error"
    causes = Figures("cause", "um rms", "variance, um^2", "share", "", title=f"{of} of axis {budget.axis}")
    for cause in found["causes"]:
        causes.add_row(
            cause["name"], f"{cause['rms_um']:.3f}", f"{cause['variance_um2']:.5f}",
            percent(cause["share_percent"]), cause["how"],
        )  # fmt: skip
    whole = percent(budget.share_percent(budget.variance_um2))
    causes.add_row(budget.sum_name, f"{budget.rms_um:.3f}", f"{budget.variance_um2:.5f}", whole, "")
    console.print(causes)
    if budget.measured_um is not None:
        with_rest = ", with what is not known" if budget.unknown else ""
        say(f"in virtual time: {budget.measured_um:.3f} um rms{with_rest}")
    bound = found["bound"]
    if bound is not None:
        say(
            f"no causal controller with these sensors leaves less than {bound['rms_um']:.3f} um, where phases are "
            f"known for {bound['coherence_s']:g} s"
        )
        ratio = "" if bound["ratio"] is None else f"; this one leaves {bound['ratio']:.1f} times that"
        say(f"of it the path's share {bound['path_um']:.3f} um, the force's {bound['force_um']:.3f} um{ratio}")
    if budget.variants:
        of_known = ", of what is known" if budget.unknown else ""
        variants = Figures("with", "um rms", title=f"Axis {budget.axis}: what it would be{of_known}")
        for variant in budget.variants:
            variants.add_row(variant.what, f"{variant.rms_um:.3f}")
        console.print(variants)
    for line in (*budget.notes, *(f"not known: {each}" for each in budget.unknown)):
        say(line)
