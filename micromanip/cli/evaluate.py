"""``micromanip evaluate``: the paper's experiment in virtual time, its table and its figures."""

from __future__ import annotations

import itertools
from functools import partial
from pathlib import Path
from typing import Any

import click

from micromanip.errors import UsageError, require_axis

from .echo import echo
from .options import Answer, Quantity, config_argument, subcommand
from .progress import show_compiling, steps
from .results import out_option, pictures_in, provenance


@subcommand("evaluate", "micromanip evaluate config/simulated.yaml --axis x --out out/evaluate")
@config_argument
@click.option("--axis", "only", help="Report and draw this axis only (all are simulated together).")
@click.option("--seed", type=Quantity("Seed"), help="Seed of the simulation's noise, instead of the configuration's.")
@out_option("the figures")
def command(config: Path, only: str | None, seed: int | None, folder: Path | None) -> Answer:
    """Run configurations A (PID), B (+ affine inverse) and C (+ tanh inverse) at 1, 5 and 10 Hz.

    All three have the one PID that reproduces the paper; a commissioned cell is also run with its own, as D.
    """
    from micromanip.design.validate.evaluation import evaluate, table, with_models
    from micromanip.settings.check import prepare
    from micromanip.virtual.experiment import VirtualExperiment

    prepared = prepare(config, seed)
    names = list(prepared.configuration.axes)
    if only is not None:
        require_axis(only, names, f" in {config}")
    real = [name for name, driver in prepared.wiring.drivers.items() if not driver.virtual]
    if real:
        raise UsageError(f"evaluate runs in virtual time: driver {real[0]} of {config} can't, it has a time of its own")
    shown = [only] if only else names
    with pictures_in(folder) as pictures, steps() as bar:
        show_compiling(bar.console.print)
        experiment = VirtualExperiment(prepared)
        configuration = with_models(prepared.configuration, experiment, bar.console.print)
        tuned = any(axis.commissioned or axis.actuator for axis in configuration.axes.values())
        total = (12 if tuned else 9) + (3 * len(shown) if folder is not None else 0)
        numbers = itertools.count(1)

        def progress() -> None:
            bar.say(f"experiment or figure {next(numbers)} of {total}")

        runs = evaluate(configuration, experiment, tuned=tuned, progress=progress)
        if folder is not None:
            from micromanip.design.plots.paper import draw_all

            for name in shown:
                about = provenance(prepared, name, seed)
                drawn = partial(draw_all, configuration, experiment, runs, names.index(name), about=about)
                pictures.draw(drawn, progress)
    rows = [row for row in table(runs, configuration) if row["axis"] in shown]

    def show() -> None:
        _print_rows(rows)
        for told in _swinging(rows):
            echo(told)
        pictures.echo()

    return Answer({"rows": rows, "seed": seed, "figures": pictures.names}, show, pictures.problem)


def _print_rows(rows: list[dict[str, Any]]) -> None:
    """Sigma and maximum of each axis beside the paper's."""
    from micromanip.design.validate import paper

    from .tables import print_table

    configurations = ", ".join(f"{letter} {label}" for letter, label in paper.LABELS.items())
    if any(row["config"] not in paper.LABELS for row in rows):
        configurations += ", D own PID + tanh inverse, with what the section actuator undoes"
    found = []
    for row in rows:
        frequency, config = row["frequency_hz"], row["config"]
        found.append((
            row["axis"], f"{frequency:g}", config,
            _beside(f"{row['std_error_um']:.3f}", paper.SIGMA_UM.get(config, {}).get(frequency), 3),
            _beside(f"{row['max_error_um']:.2f}", paper.MAXIMUM_UM.get(config, {}).get(frequency), 2),
            f"{row['max_error_with_start_um']:.2f}",
            "-" if row["true_std_error_um"] is None else f"{row['true_std_error_um']:.3f}",
            "-" if row["true_max_error_um"] is None else f"{row['true_max_error_um']:.2f}",
        ))  # fmt: skip
    columns = ("axis", "Hz", "", "sigma", "maximum", "with start", "true sigma", "true max")
    title = "Control error on the actuator side, um (the paper's figure in brackets)"
    print_table(columns, found, title, configurations, numbers=True)


def _swinging(rows: list[dict[str, Any]]) -> list[str]:
    """A sentence for each axis and configuration that swings by itself: its figures say nothing of the models."""
    found: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        if row["swings_hz"] is not None:
            found.setdefault((row["axis"], row["config"]), []).append(row["swings_hz"])
    return [
        f"{config}, axis {axis}: the strain loop swings by itself at {hertz[0]:.0f} Hz, most of the error: its "
        "PID is not for this actuator, and the figures say nothing of the models"
        for (axis, config), hertz in found.items()
    ]


def _beside(value: str, papers: float | None, digits: int) -> str:
    """`value` with the paper's figure in brackets, where it has one."""
    return value if papers is None else f"{value} ({papers:.{digits}f})"
