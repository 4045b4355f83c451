"""``micromanip commission``: from factory values to a tuned, validated axis, with its report."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from shutil import copyfile
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import CheckFailed, MicromanipError, sentence, system_error

from .echo import echo
from .options import Answer, Quantity, chosen_axes, config_argument, moved_axis_option, socket_option, subcommand
from .progress import steps
from .results import out_option, publish, results_folder, run_folder

if TYPE_CHECKING:
    from micromanip.design.commission.cell import CommissionedCell
    from micromanip.design.experiment import Experiment
    from micromanip.settings.check import Prepared
    from micromanip.settings.schema.axis import Axis

REPORT, TUNED, PREVIOUS, REJECTED = "report.html", "tuned.yaml", "previous.yaml", "rejected.yaml"
_EXPERIMENTS = ".experiments"


@subcommand("commission", "micromanip commission config/factory.yaml --axis all --out out/cell")
@config_argument
@moved_axis_option
@out_option(f"{TUNED}, {REPORT} and {PREVIOUS}", required=True)
@click.option(
    "--bandwidth", "bandwidth_Hz", type=Quantity("Hertz", least=1.0), metavar="HZ",
    help="Crossover of the outer loop  [default: the highest that keeps the margins]",
)  # fmt: skip
@click.option(
    "--noise", "noise_um", type=Quantity("Distance", least=1e-4), metavar="UM",
    help="Noise of the capacitive sensor, rms: more makes the outer loop calmer  [default: as measured]",
)  # fmt: skip
@click.option(
    "--tooth-frequency", "tooth_Hz", type=Quantity("Hertz", least=1.0), metavar="HZ",
    help="Tooth-passing frequency in Hz that the outer loop cancels  [default: as the axis has it, or as it is seen]",
)  # fmt: skip
@click.option("--seed", type=Quantity("Seed"), default=1, help="Of the excitations.")
@click.option("--live", is_flag=True, help="Through the running loop also on a simulation, in real time.")
@click.option("--yes", is_flag=True, help="Don't ask before a real stage moves.")
@socket_option
def command(
    config: Path, only: str, folder: Path, bandwidth_Hz: float | None, noise_um: float | None, tooth_Hz: float | None,
    seed: int, live: bool, yes: bool, socket_path: Path,
) -> Answer:  # fmt: skip
    """Identify an axis, design its controllers, try them on a fresh experiment, and report.

    A cell with a tracker, all of whose axes are tuned by then, ends in a file that tracks, and is tried as it will run.
    CONFIG is not changed and nothing is applied: the new tuning is DIR/tuned.yaml, complete, for `check` and `run`;
    the one before is kept beside it. Each run also has a folder of its own in DIR, which nothing replaces; `latest`
    is the last. PASS: all criteria are met. PASS WITH LESS, exit code 1: the margins are proven, the accuracy is less
    than asked; tuned.yaml runs. FAIL, exit code 1: a step or a margin says no; the report says what was found by then,
    and a tuning that was found is kept as rejected.yaml.
    """
    from micromanip.design.analyse.budget.recorded import budget_of_rows
    from micromanip.design.commission.cell import commission_cell, planned
    from micromanip.design.commission.closing import Options
    from micromanip.design.commission.written import as_written, provenance
    from micromanip.settings.check import prepare

    prepared = prepare(config)
    chosen = chosen_axes(prepared.configuration.axes, only, config)
    real = prepared.wiring.real
    with results_folder(folder):
        if real and not yes:
            _ask(prepared, chosen, real[0])
        began = time.monotonic()
        virtual = not live and prepared.wiring.virtual
        simulated = contextlib.nullcontext(partial(_virtual, prepared))
        with (
            simulated if virtual else _live(prepared, socket_path, folder / _EXPERIMENTS) as played,
            run_folder(folder, only, wanted=REPORT) as run,
            steps(planned(chosen)) as bar,
        ):
            copyfile(config, run / PREVIOUS)
            found = commission_cell(
                prepared.configuration,
                played(process=False),
                chosen,
                bar.say,
                Options(bandwidth_Hz, noise_um, tooth_Hz),
                seed,
                played(process=True),
                partial(as_written, prepared),
                partial(budget_of_rows, prepared.source.path),
            )
            bar.say("report")
            facts = provenance(prepared, config, chosen, seed)
            axes, missing = _write_results(prepared, found, facts, folder, run)
    seconds = time.monotonic() - began
    return Answer(
        _document(found, axes, folder, run, seconds),
        lambda: _print_found(found, folder, run, seconds),
        missing or _failure(found, folder),
    )


def _failure(found: CommissionedCell, folder: Path) -> CheckFailed | None:
    """What was not reached, None of an axis that passed."""
    if found.stopped is not None:
        return CheckFailed(f"{sentence(found.stopped)} What was found by then is in {folder / REPORT}")
    failed = [criterion for story in found.evidence for criterion in story.criteria if not criterion.passed]
    if not failed:
        return None
    first, more = failed[0], f", and {len(failed) - 1} more" if failed[1:] else ""
    missed = f"axis {first.axis}, {first.name}: {first.value} (wanted: {first.limit}){more}"
    if found.proven:
        less = "PASS WITH LESS: the margins are proven, the accuracy is less than asked"
        return CheckFailed(f"{less}: {missed}. {folder / TUNED} runs as it is")
    stalled = f". {found.stalled}" if found.stalled else ""
    kept = f"the tuning is kept as {folder / REJECTED}, the report is {folder / REPORT}"
    return CheckFailed(f"FAIL: {missed}; {kept}{stalled}")


def _ask(prepared: Prepared, chosen: list[str], driver: str) -> None:
    echo(f"Driver {driver} moves a real stage. In open and in closed loop, one after the other, will move:", err=True)
    for name in chosen:
        low, high = prepared.configuration.outputs[f"voltage_{name}"].range_V
        echo(f"  axis {name}: {low:g} to {high:g} V, for about two minutes", err=True)
    click.confirm("Is the spindle free and nobody near it?", abort=True, err=True)


def _virtual(prepared: Prepared, *, process: bool) -> Experiment:
    from micromanip.virtual.experiment import VirtualExperiment

    return VirtualExperiment(prepared, process=process)


@contextlib.contextmanager
def _live(prepared: Prepared, socket_path: Path, folder: Path) -> Iterator[Callable[..., Experiment]]:
    """Experiments in real time, whose recordings stay in `folder` only where the run is broken off."""
    from .live_experiment import LiveCell, LiveExperiment

    cell = LiveCell(prepared, socket_path, folder)
    if cell.left:
        echo(f"goes on where a run was broken off: {cell.left} experiments of it are in {folder}", err=True)
    try:
        try:
            yield partial(LiveExperiment, cell)
        finally:
            cell.end()
    except KeyboardInterrupt:
        if cell.asked:
            echo("broken off, outputs at rest; within the hour the same command goes on from here", err=True)
        raise
    except BaseException:
        shutil.rmtree(folder)
        raise
    shutil.rmtree(folder)


def _write_results(
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
        write_atomically(run / named, tuned)
    try:
        write_report(run / REPORT, "Commissioning report", facts, found.evidence, hashes)
        publish(folder, run, (PREVIOUS, REPORT, TUNED, REJECTED))
    except OSError as problem:
        cause = system_error(problem)
        return noted, type(cause)(f"not everything is written, the tuning is {run / named}: {cause}")
    return noted, None


def _document(
    found: CommissionedCell, axes: dict[str, Axis], folder: Path, run: Path, seconds: float
) -> dict[str, Any]:
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


def _print_found(found: CommissionedCell, folder: Path, run: Path, seconds: float) -> None:
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
    tuning = f"tuning in {folder / TUNED}" if found.proven else "no tuning to run"
    echo(f"{seconds:.0f} s; {tuning}, report in {folder / REPORT}; nothing was applied")
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
