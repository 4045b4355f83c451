"""``micromanip evaluate``: the paper's experiment in virtual time, its table and its page."""

from __future__ import annotations

import itertools
from pathlib import Path

import click

from micromanip.errors import UsageError, require_axis

from .echo import echo
from .options import Answer, Quantity, config_argument, subcommand
from .progress import show_compiling, steps
from .results import out_option, page_in, provenance


@subcommand("evaluate", "micromanip evaluate config/simulated.yaml --axis x --out out/evaluate")
@config_argument
@click.option("--axis", "only", help="Report and draw this axis only (all are simulated together).")
@click.option("--seed", type=Quantity("Seed"), help="Seed of the simulation's noise, instead of the configuration's.")
@out_option("the page evaluate.html")
def command(config: Path, only: str | None, seed: int | None, folder: Path | None) -> Answer:
    """Run configurations A (PID), B (+ affine inverse) and C (+ tanh inverse) at 1, 5 and 10 Hz.

    All three have the one PID that reproduces the paper; a commissioned cell is also run with its own, as D.
    """
    from micromanip.design.report.model import Section
    from micromanip.design.validate.evaluation import evaluate, table, with_models
    from micromanip.design.validate.paper import beside_the_paper, swinging
    from micromanip.settings.check import prepare
    from micromanip.virtual.experiment import VirtualExperiment

    from .tables import print_table

    prepared = prepare(config, seed)
    names = list(prepared.configuration.axes)
    if only is not None:
        require_axis(only, names, f" in {config}")
    real = [name for name, driver in prepared.wiring.drivers.items() if not driver.virtual]
    if real:
        raise UsageError(f"evaluate runs in virtual time: driver {real[0]} of {config} can't, it has a time of its own")
    shown = [only] if only else names
    with page_in(folder, "evaluate.html") as page, steps() as bar:
        show_compiling(bar.console.print)
        experiment = VirtualExperiment(prepared)
        configuration = with_models(prepared.configuration, experiment, bar.console.print)
        tuned = any(axis.commissioned or axis.actuator for axis in configuration.axes.values())
        total = (12 if tuned else 9) + (len(shown) if folder is not None else 0)
        numbers = itertools.count(1)

        def progress() -> None:
            bar.say(f"experiment or figure {next(numbers)} of {total}")

        runs = evaluate(configuration, experiment, tuned=tuned, progress=progress)
        rows = [row for row in table(runs, configuration) if row["axis"] in shown]
        found = beside_the_paper(rows)
        if folder is not None:
            from micromanip.design.plots.paper import paper_sections

            sections = [Section("Control error", "\n\n".join(swinging(rows)), tables=(found,))]
            for name in shown:
                about = provenance(prepared, name, seed)
                sections += paper_sections(configuration, experiment, runs, names.index(name), about)
                progress()
            page.write(f"Sines of {config}", sections)

    def show() -> None:
        print_table(found.heads, found.rows, found.caption, numbers=True)
        for told in swinging(rows):
            echo(told)
        page.echo()

    return Answer({"rows": rows, "seed": seed, "page": page.name}, show, page.problem)
