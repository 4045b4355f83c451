"""``micromanip analyse error``: what the path error is made of."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .axes import axis_option, chosen_axes
from .echo import echo
from .options import Quantity, emit_json, subcommand
from .progress import steps
from .recording_options import open_recording
from .results import out_option

if TYPE_CHECKING:
    from micromanip.design.analyse.budget.budget import AxisBudget

_CONFIGURATIONS = (".yaml", ".yml")


@subcommand("error", "micromanip analyse error config/simulated.yaml --out out/error")
@click.argument("file", type=click.Path(path_type=Path), metavar="CONFIG|RECORDING")
@axis_option
@click.option(
    "--seconds", type=Quantity("SecondsOrZero", most=600.0), default=10.0, metavar="S",
    help="Virtual time that a simulated cell is played for; 0: not at all.",
)  # fmt: skip
@click.option("--seed", type=Quantity("Seed"), default=1, help="Of the noise that is played.")
@click.option(
    "--coherence", "coherence_s", type=Quantity("Seconds", least=0.05, most=60.0), default=1.0,
    metavar="S", help="For how long path and force keep their phase: what the bound takes for granted.",
)  # fmt: skip
@out_option("pictures", metavar="DIR")
def command(
    file: Path, only: str, seconds: float, seed: int, coherence_s: float, folder: Path | None, as_json: bool
) -> None:
    """Variance of the path error by cause; a bound that no causal controller can beat; what other sensors would give.

    Of a configuration (.yaml) it is computed from the models; a simulated cell is also played, in virtual time, for
    what no linear model shows. Of a recording it is what the recorded signals show. docs/analyse.md explains it.
    """
    from .results import Pictures

    with Pictures(folder) as pictures, steps() as bar:
        if file.suffix.lower() in _CONFIGURATIONS:
            budgets, about = _of_configuration(file, only, seconds, seed, coherence_s, bar.say)
        else:
            budgets, about = _of_recording(file, only, coherence_s, bar.say)
        if folder is not None:
            from micromanip.design.plots.findings import draw_budgets

            bar.say("drawing")
            pictures.draw(partial(draw_budgets, budgets, about))
        written = pictures.put()
    if as_json:
        emit_json(
            {"file": str(file), "axes": [each.document() for each in budgets], "files": [str(f) for f in written]}
        )
    else:
        for budget in budgets:
            _print(budget)
        for picture in written:
            echo(f"wrote {picture}")
    pictures.require_written()


def _of_configuration(
    file: Path, only: str, seconds: float, seed: int, coherence_s: float, step: Callable[[str], None]
) -> tuple[list[AxisBudget], str]:
    from micromanip.design.analyse.budget.configured import budget_of
    from micromanip.settings.check import prepare

    prepared = prepare(file, seed)
    axes = chosen_axes(prepared.configuration.axes, only, file)
    return budget_of(prepared, axes, seconds, seed, coherence_s, step), f"{file}, seed {seed}"


def _of_recording(
    file: Path, only: str, coherence_s: float, step: Callable[[str], None]
) -> tuple[list[AxisBudget], str]:
    from micromanip.design.analyse.budget.recorded import recorded_budget

    telemetry = open_recording(file)
    return recorded_budget(telemetry, chosen_axes(telemetry.axes, only, file), coherence_s, step), str(file)


def _print(budget: AxisBudget) -> None:
    from micromanip.design.analyse.budget.budget import percent

    from .tables import print_table

    found = budget.document()
    of = "What is known of the path error" if budget.unknown else "Path error"
    whole = percent(budget.share_percent(budget.variance_um2))
    rows = [
        *(
            (each["name"], each["rms_um"], each["variance_um2"], percent(each["share_percent"]), each["how"])
            for each in found["causes"]
        ),
        (budget.sum_name, budget.rms_um, budget.variance_um2, whole, ""),
    ]
    print_table(
        ("cause", "um rms", "variance, um^2", "share", ""),
        ((name, f"{rms:.3f}", f"{variance:.5f}", share, how) for name, rms, variance, share, how in rows),
        f"{of} of axis {budget.axis}",
    )
    if budget.measured_um is not None:
        with_rest = ", with what is not known" if budget.unknown else ""
        echo(f"in virtual time: {budget.measured_um:.3f} um rms{with_rest}")
    bound = found["bound"]
    if bound is not None:
        echo(
            f"no causal controller with these sensors leaves less than {bound['rms_um']:.3f} um, where phases are "
            f"known for {bound['coherence_s']:g} s"
        )
        ratio = "" if bound["ratio"] is None else f"; this one leaves {bound['ratio']:.1f} times that"
        echo(f"of it the path's share {bound['path_um']:.3f} um, the force's {bound['force_um']:.3f} um{ratio}")
    if budget.variants:
        of_known = ", of what is known" if budget.unknown else ""
        print_table(
            ("with", "um rms"),
            ((variant.what, f"{variant.rms_um:.3f}") for variant in budget.variants),
            f"Axis {budget.axis}: what it would be{of_known}",
        )
    for line in (*budget.notes, *(f"not known: {each}" for each in budget.unknown)):
        echo(line)
