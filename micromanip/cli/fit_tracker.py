"""``micromanip fit tracker``: what the predictor of a tracker's samples should know of each axis' deviation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.design.identify.tracker.recorded import MOVES_PERCENT
from micromanip.errors import CheckFailed

from .echo import echo
from .options import Answer, Quantity, axis_option, chosen_axes, subcommand
from .progress import steps
from .recording_options import open_recording

if TYPE_CHECKING:
    from micromanip.design.identify.tracker.fit import Deviation


@subcommand("tracker", "micromanip fit tracker run.mcap --into config/cell.yaml")
@click.argument("file", type=click.Path(path_type=Path), metavar="RECORDING")
@axis_option
@click.option(
    "--moves", "moves_percent", type=Quantity("NotNegative", most=50.0), default=MOVES_PERCENT,
    metavar="PERCENT", help="By how much an oscillation's frequency may be another than in the recording until it is "
    "found; 0: it is not looked for.",
)  # fmt: skip
@click.option("--into", type=click.Path(path_type=Path), help="Configuration file to put it into, as reference.axes.")
def command(file: Path, only: str, moves_percent: float, into: Path | None) -> Answer:
    """Noise, jerk and up to three oscillations of each axis' path deviation, from the tracker's samples in RECORDING.

    By maximum likelihood; the number of oscillations by samples held out. Record the robot on its path, as it will run:
    one that stands still shows no jerk. Exit code 1 where the samples don't do.
    """
    from micromanip.design.analyse.budget.path_record import predicted_shares
    from micromanip.design.identify.tracker.configured import put, require_tracker
    from micromanip.design.identify.tracker.fit import fit_deviation
    from micromanip.design.identify.tracker.recorded import recorded_samples
    from micromanip.settings.text.source import Source

    telemetry = open_recording(file)
    axes = chosen_axes(telemetry.axes, only, file)
    source = None if into is None else Source.read(into)
    if source is not None:
        require_tracker(source)
    found, shares = {}, {}
    with steps() as bar:
        for axis in axes:
            bar.say(f"axis {axis}")
            samples, rate_Hz = recorded_samples(telemetry, axis)
            try:
                found[axis] = fit_deviation(samples, rate_Hz, moves_percent)
            except CheckFailed as problem:
                raise CheckFailed(f"{file}: axis {axis}: {problem}") from problem
            shares[axis] = predicted_shares(telemetry, axis, found[axis].model)
    if source is not None:
        put(source, found)
    told = {axis: _document(each, shares[axis]) for axis, each in found.items()}

    def show() -> None:
        _print(told)
        if into is not None:
            echo(f"wrote reference.axes of {into}")

    return Answer({"file": str(file), "axes": told, "into": None if into is None else str(into)}, show)


def _document(found: Deviation, share: dict[str, Any]) -> dict[str, Any]:
    held_out, fitted = found.held_out, found.fitted
    return {
        **found.settings(),
        "amplitudes_um": list(found.amplitudes_um),
        "seconds": found.seconds,
        "nis_held_out": held_out.nis,
        "nis_bounds": list(held_out.nis_bounds),
        "correlation": fitted.correlation,
        "correlation_bound": fitted.correlation_bound,
        "white": fitted.white,
        "path_share_um": share,
        "notes": list(found.notes),
    }


def _print(axes: dict[str, dict[str, Any]]) -> None:
    from .tables import print_table

    rows = []
    for axis, each in axes.items():
        swinging = ", ".join(f"{o['frequency_Hz']:.4g} ({o['um_per_s']:.3g})" for o in each["oscillations"]) or "none"
        noise, jerk, nis = f"{each['noise_um']:.3g}", f"{each['jerk_um_per_s3']:.3g}", f"{each['nis_held_out']:.3f}"
        rows.append((axis, noise, jerk, swinging, nis))
    print_table(("axis", "noise, um", "jerk, um/s^3", "oscillations, Hz (um/s)", "NIS held out"), rows, "Deviation")
    for axis, each in axes.items():
        share = each["path_share_um"]
        if share["reason"] is None:
            echo(
                f"axis {axis}: the tracker's noise, delay and prediction leave {share['after_um']:.3f} um rms of this "
                f"path, {share['before_um']:.3f} um as it ran"
            )
        else:
            echo(f"axis {axis}: no prediction of the path error: {share['reason']}")
        for note in each["notes"]:
            echo(f"axis {axis}: {note}")
