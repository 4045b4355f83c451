"""``micromanip commission``: from factory values to a tuned, validated axis, with its report."""

from __future__ import annotations

import contextlib
import datetime
import getpass
import os
import shutil
import time
from collections.abc import Iterator
from functools import partial
from importlib.metadata import version
from pathlib import Path
from shutil import copyfile
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import CheckFailed, sentence

from .axes import chosen_axes, moved_axis_option
from .commissioned import PREVIOUS, REJECTED, REPORT, TUNED, document, print_found, tuned_text, write_results
from .echo import echo
from .options import Quantity, config_argument, emit_json, socket_option, subcommand
from .progress import steps
from .results import out_option, results_folder, run_folder

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from micromanip.design.analyse.budget.budget import AxisBudget
    from micromanip.design.experiment import Experiment
    from micromanip.settings.check import Prepared
    from micromanip.settings.schema.model import Configuration

    from .live_experiment import Recordings

_EXPERIMENTS = ".experiments"
_BUDGET_S, _COHERENCE_S = 4.0, 1.0
"""Virtual time that is played for the error budget; for how long its bound takes phases to be known."""


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
    from micromanip.design.commission.cell import commission_cell, planned
    from micromanip.design.commission.options import Options
    from micromanip.settings.check import prepare

    prepared = prepare(config)
    chosen = chosen_axes(prepared.configuration.axes, only, config)
    real = prepared.wiring.real
    with results_folder(folder):
        if real and not yes:
            _ask(prepared, chosen, real[0])
        began = time.monotonic()
        with (
            _resumed(folder / _EXPERIMENTS) as resumed,
            run_folder(folder, only, wanted=REPORT) as run,
            steps(planned(chosen)) as bar,
        ):
            copyfile(config, run / PREVIOUS)
            played = (
                partial(_live, prepared, socket_path, resumed)
                if live or not prepared.wiring.virtual
                else partial(_virtual, prepared)
            )
            found = commission_cell(
                prepared.configuration,
                played(process=False),
                chosen,
                bar.say,
                Options(bandwidth_Hz, noise_um, tooth_Hz),
                seed,
                played(process=True),
                partial(_as_written, prepared),
                partial(_budgeted, prepared, seed, virtual=not live and prepared.wiring.virtual),
            )
            bar.say("report")
            facts = _provenance(prepared, config, chosen, seed)
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


def _live(prepared: Prepared, socket_path: Path, kept: Recordings, *, process: bool) -> Experiment:
    from .live_experiment import LiveExperiment

    return LiveExperiment(prepared, socket_path, kept, process=process)


@contextlib.contextmanager
def _resumed(folder: Path) -> Iterator[Recordings]:
    """The experiments of this run, which stay only where it is broken off."""
    from .live_experiment import Recordings

    kept = Recordings(folder)
    if kept.left:
        echo(f"goes on where a run was broken off: {kept.left} experiments of it are in {folder}", err=True)
    try:
        yield kept
    except KeyboardInterrupt:
        if kept.asked:
            echo("broken off, outputs at rest; within the hour the same command goes on from here", err=True)
        raise
    except BaseException:
        shutil.rmtree(folder)
        raise
    shutil.rmtree(folder)


def _as_written(prepared: Prepared, configuration: Configuration) -> Configuration:
    """What a file of `configuration` holds once it is read again; raises ConfigError where `check` would."""
    from micromanip.settings.check import wired
    from micromanip.settings.text.source import Source

    read, _ = wired(Source.parse(prepared.source.path, tuned_text(prepared, configuration, configuration.axes)))
    return read


def _budgeted(
    prepared: Prepared, seed: int, configuration: Configuration, rows: NDArray[Any], *, virtual: bool
) -> list[AxisBudget]:
    """Of a cell in virtual time computed, and played once more without noise; else what the trial's rows show."""
    import numpy as np

    from micromanip.design.analyse.budget.configured import budget_of
    from micromanip.design.analyse.budget.recorded import recorded_budget
    from micromanip.recordings import Telemetry
    from micromanip.settings.check import prepared as prepared_of
    from micromanip.settings.text.source import Source

    text, axes = tuned_text(prepared, configuration, configuration.axes), list(configuration.axes)
    if virtual:
        tuned = prepared_of(Source.parse(prepared.source.path, text))
        return budget_of(tuned, axes, _BUDGET_S, seed, _COHERENCE_S, _silent)
    _, own = np.unique(rows["cycle"], return_index=True)  # a skipped cycle's row is a copy of the one before
    telemetry = Telemetry.of_rows(prepared.source.path, axes, configuration.loop.period_ns, rows[own], text)
    return recorded_budget(telemetry, axes, _COHERENCE_S, _silent)


def _silent(_: str) -> None:
    pass


def _provenance(prepared: Prepared, config: Path, chosen: list[str], seed: int) -> dict[str, str]:
    """Where a report comes from: simulated or hardware, which version, when, by whom, with which sensors."""
    drivers = {name: prepared.wiring.drivers[name] for name in prepared.configuration.drivers}
    devices = {name: driver.device or prepared.configuration.drivers[name].driver for name, driver in drivers.items()}
    sensors = {
        f"sensors of {axis}": ", ".join(
            f"{name} at {devices[entry.driver]}" + (f" ({entry.channel})" if entry.channel else "")
            for name in (f"strain_{axis}", f"stage_{axis}", f"deviation_{axis}")
            if (entry := prepared.configuration.signals.get(name)) is not None
        )
        for axis in chosen
    }
    return {
        "cell": f"hardware: {', '.join(devices[name] for name in prepared.wiring.real)}"
        if prepared.wiring.real
        else "simulated, nothing real moved",
        "configuration": f"{config} ({prepared.source.hash[:8]})",
        "time": f"{datetime.datetime.now(datetime.UTC):%Y-%m-%dT%H:%M:%SZ}",
        "operator": _logged_in(),
        "version": f"micromanip {version('micromanip')}",
        "rate": f"{prepared.configuration.loop.rate_hz:g} Hz",
        "seed": str(seed),
        **sensors,
    }


def _logged_in() -> str:
    try:
        return os.environ.get("SUDO_USER") or getpass.getuser()
    except (KeyError, OSError):  # a user without an entry, as in a container
        return f"user {os.getuid()}"
