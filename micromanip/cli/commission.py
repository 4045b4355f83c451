"""``micromanip commission``: from factory values to a tuned, validated axis, with its report."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from shutil import copyfile
from typing import TYPE_CHECKING

import click

from micromanip.errors import CheckFailed, sentence

from .axes import chosen_axes, moved_axis_option
from .commissioned import PREVIOUS, REJECTED, REPORT, TUNED, document, print_found, write_results
from .echo import echo
from .options import Quantity, config_argument, emit_json, socket_option, subcommand
from .progress import steps
from .results import out_option, results_folder, run_folder

if TYPE_CHECKING:
    from micromanip.design.experiment import Experiment
    from micromanip.settings.check import Prepared

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
    seed: int, live: bool, yes: bool, socket_path: Path, as_json: bool,
) -> None:  # fmt: skip
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
            axes, missing = write_results(prepared, found, facts, folder, run)
    seconds = time.monotonic() - began
    if as_json:
        emit_json(document(found, axes, folder, run, seconds))
    else:
        print_found(found, folder, run, seconds)
    if missing is not None:
        raise missing
    if found.stopped is not None:
        raise CheckFailed(f"{sentence(found.stopped)} What was found by then is in {folder / REPORT}")
    failed = [criterion for story in found.evidence for criterion in story.criteria if not criterion.passed]
    if not failed:
        return
    first, more = failed[0], f", and {len(failed) - 1} more" if failed[1:] else ""
    missed = f"axis {first.axis}, {first.name}: {first.value} (wanted: {first.limit}){more}"
    if found.proven:
        less = "PASS WITH LESS: the margins are proven, the accuracy is less than asked"
        raise CheckFailed(f"{less}: {missed}. {folder / TUNED} runs as it is")
    stalled = f". {found.stalled}" if found.stalled else ""
    kept = f"the tuning is kept as {folder / REJECTED}, the report is {folder / REPORT}"
    raise CheckFailed(f"FAIL: {missed}; {kept}{stalled}")


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
