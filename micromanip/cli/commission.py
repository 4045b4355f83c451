"""``micromanip commission``: from factory values to a tuned, validated axis, with its report."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable
from pathlib import Path
from shutil import copyfile
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import CheckFailed, MicromanipError, UsageError, system_error

from .options import Quantity, StrictCommand, config_argument, json_option, prepare_and_warn, print_json, socket_option
from .results import keep, publish, results_folder, run_folder

if TYPE_CHECKING:
    from micromanip.design.commission.cell import CommissionedCell
    from micromanip.design.experiment import Experiment
    from micromanip.settings.check import Prepared
    from micromanip.settings.schema.axis import Axis

REPORT, TUNED, PREVIOUS, REJECTED = "report.html", "tuned.yaml", "previous.yaml", "rejected.yaml"


@click.command(
    "commission",
    cls=StrictCommand,
    epilog="Example: micromanip commission config/factory.yaml --axis all --out out/cell",
)
@config_argument
@click.option("--axis", "only", required=True, help="The axis, or all of them one after the other: all.")
@click.option(
    "--out", "folder", type=click.Path(path_type=Path, file_okay=False), required=True,
    help=f"Folder for {TUNED}, {REPORT} and {PREVIOUS}.",
)  # fmt: skip
@click.option(
    "--bandwidth", "bandwidth_Hz", type=Quantity("Hertz", least=1.0), metavar="HZ",
    help="Crossover of the outer loop  [default: the highest that keeps the margins]",
)  # fmt: skip
@click.option(
    "--noise", "noise_um", type=Quantity("Distance", least=1e-4), metavar="UM",
    help="Noise of the capacitive sensor, rms: more makes the outer loop calmer  [default: as measured]",
)  # fmt: skip
@click.option("--seed", type=Quantity("Seed"), default=1, show_default=True, help="Of the excitations.")
@click.option("--live", is_flag=True, help="Through the running loop also on a simulation, in real time.")
@click.option("--yes", is_flag=True, help="Don't ask before a real stage moves.")
@socket_option
@json_option
def command(
    config: Path, only: str, folder: Path, bandwidth_Hz: float | None, noise_um: float | None, seed: int, live: bool,
    yes: bool, socket_path: Path, as_json: bool,
) -> None:  # fmt: skip
    """Identify an axis, design its controllers, try them on a fresh experiment, and report.

    CONFIG is not changed and nothing is applied: the new tuning is DIR/tuned.yaml, complete, for `check` and `run`;
    the one before is kept beside it. Each run also has a folder of its own in DIR, which nothing replaces; `latest`
    is the last. Exit code 1 where a step or a criterion says no: then the report says what was found by then, and a
    tuning that was found is kept as rejected.yaml.
    """
    from rich.console import Console
    from rich.progress import Progress

    from micromanip.design.commission.axis import Knobs
    from micromanip.design.commission.cell import commission_cell

    prepared = prepare_and_warn(config)
    names = list(prepared.configuration.axes)
    if only != "all" and only not in names:
        raise UsageError(f"there is no axis {only} in {config}; its axes are {', '.join(names)}")
    chosen = names if only == "all" else [only]
    _require_stage_sensors(prepared, chosen)
    real = [name for name, driver in prepared.wiring.drivers.items() if not driver.simulated]
    with results_folder(folder):
        if real and not yes:
            _ask(prepared, chosen, real[0])
        began = time.monotonic()
        with (
            run_folder(folder, only, wanted=REPORT) as run,
            Progress(console=Console(stderr=True), transient=True) as bar,
        ):
            copyfile(config, run / PREVIOUS)
            task = bar.add_task("commission", total=None)
            experiment = (
                _experiment(prepared, socket_path) if live or not prepared.wiring.virtual else _virtual(prepared)
            )
            found = commission_cell(
                prepared.configuration,
                experiment,
                chosen,
                lambda what: bar.update(task, description=what),
                Knobs(bandwidth_Hz, noise_um),
                seed,
            )
            bar.update(task, description="report")
            axes, missing = write_results(prepared, found, config, folder, run)
    seconds = time.monotonic() - began
    if as_json:
        print_json(_document(found, axes, folder, run, seconds))
    else:
        _print(found, folder, run, seconds)
    if missing is not None:
        raise missing
    if found.stopped is not None:
        raise CheckFailed(f"{found.stopped}; what was found by then is in {folder / REPORT}")
    failed = [criterion for story in found.evidence for criterion in story.criteria if not criterion.passed]
    if failed:
        worst = failed[0]
        raise CheckFailed(
            f"{len(failed)} criteria fail, the first: axis {worst.axis}, {worst.name}: {worst.value} "
            f"(wanted: {worst.limit}); the tuning is kept as {folder / REJECTED}, the report is {folder / REPORT}"
        )


def _require_stage_sensors(prepared: Prepared, chosen: list[str]) -> None:
    for name in chosen:
        if f"stage_{name}" not in prepared.configuration.signals:
            raise UsageError(f"axis {name} has no signal stage_{name}: the outer loop needs the capacitive sensor")


def _ask(prepared: Prepared, chosen: list[str], driver: str) -> None:
    click.echo(
        f"Driver {driver} moves a real stage. In open and in closed loop, one after the other, will move:", err=True
    )
    for name in chosen:
        low, high = prepared.configuration.outputs[f"voltage_{name}"].range_V
        click.echo(f"  axis {name}: {low:g} to {high:g} V, for about two minutes", err=True)
    click.confirm("Is the spindle free and nobody near it?", abort=True, err=True)


def _virtual(prepared: Prepared) -> Experiment:
    from micromanip.virtual.experiment import VirtualExperiment

    return VirtualExperiment(prepared)


def _experiment(prepared: Prepared, socket_path: Path) -> Experiment:
    from .played import LiveExperiment

    return LiveExperiment(prepared, socket_path)


def write_results(
    prepared: Prepared, found: CommissionedCell, config: Path, folder: Path, run: Path
) -> tuple[dict[str, Axis], MicromanipError | None]:
    """Write tuning and report into `run`, and copies into `folder`; the axes with their notes, and what is missing.

    The tuning comes first: it is small, and what the axis was moved for. Raises where even that finds no room. One that
    does not pass is not called tuned.
    """
    from micromanip.design.commission.report import write_report
    from micromanip.settings.commissioned import tuning_hash
    from micromanip.settings.schema.axis import Commissioned
    from micromanip.settings.write import with_tuning, write_atomically

    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    axes = {each.axis: found.configuration.axes[each.axis] for each in found.axes}
    hashes = {name: tuning_hash(axis) for name, axis in axes.items()}
    noted = {
        name: axis.model_copy(update={"commissioned": Commissioned(hash=hashes[name], report=REPORT, date=today)})
        for name, axis in axes.items()
    }
    facts = {"configuration": str(config), "date": today, "rate": f"{prepared.configuration.loop.rate_hz:g} Hz"}
    tuned = with_tuning(prepared.source.text, noted)
    named = TUNED if found.passed else REJECTED
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


def _document(
    found: CommissionedCell, axes: dict[str, Axis], folder: Path, run: Path, seconds: float
) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "passed": found.passed,
        "seconds": seconds,
        "tuned": str(folder / TUNED) if found.passed else None,
        "rejected": str(folder / REJECTED) if found.axes and not found.passed else None,
        "stopped": None if found.stopped is None else str(found.stopped),
        "report": str(folder / REPORT),
        "run": str(run),
        "axes": {
            story.axis: {
                "passed": story.passed,
                "hash": _hash_of(axes, story.axis),
                "criteria": [asdict(criterion) for criterion in story.criteria],
            }
            for story in found.evidence
        },
    }


def _hash_of(axes: dict[str, Axis], name: str) -> str | None:
    noted = axes[name].commissioned if name in axes else None
    return None if noted is None else noted.hash


def _print(found: CommissionedCell, folder: Path, run: Path, seconds: float) -> None:
    from rich.padding import Padding
    from rich.text import Text

    from .analyse import print_criteria
    from .tables import out_console

    for story in found.evidence:
        missed = [criterion for criterion in story.criteria if not criterion.passed]
        met = [criterion for criterion in story.criteria if criterion.passed]
        print_criteria(missed, "Not met")
        verdict = "[red]FAIL[/]" if missed else "[green]PASS[/]"
        out_console().print(f"axis {story.axis}: {verdict}, {len(met)} of {len(story.criteria)} criteria are met")
        for criterion in met:
            out_console().print(Padding(Text(f"{criterion.name}: {criterion.value}"), (0, 0, 0, 2)))
    if found.passed:
        click.echo(f"{seconds:.0f} s; tuning in {folder / TUNED}, report in {folder / REPORT}; nothing was applied")
    else:
        click.echo(f"{seconds:.0f} s; no tuning to run, report in {folder / REPORT}; nothing was applied")
    click.echo(f"this run's files stay in {run}")
    if found.passed:
        click.echo(f"next: micromanip check {folder / TUNED}")
