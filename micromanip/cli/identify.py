"""``micromanip identify``: play a safe excitation on one axis and record it."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import CheckFailed, require_axis, sentence

from .echo import echo
from .options import Answer, Quantity, config_argument, one_axis_option, socket_option, subcommand
from .results import out_option, require_new, results_folder

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from micromanip.settings.check import Prepared


@subcommand("identify", "micromanip identify config/factory.yaml --axis x --out out/identify")
@config_argument
@one_axis_option
@out_option("the CSV", required=True)
@click.option(
    "--kind",
    type=click.Choice(["multisine", "turns", "triangle", "step"]),
    default="multisine",
    help="turns: random turning points, what a network needs; triangle: major loop; step: creep.",
)
@click.option(
    "--seconds", type=Quantity("Seconds", least=1.0, most=600.0), help="Length  [default: 13, 60, 24 and 60 by kind]"
)
@click.option("--seed", type=Quantity("Seed"), default=1, help="Draws the multisine's phases, the turning points.")
@click.option(
    "--live", is_flag=True, help="Through the running loop, in real time; a simulation otherwise runs in virtual time."
)
@click.option("--yes", is_flag=True, help="Don't ask before a real stage moves.")
@socket_option
def command(
    config: Path, axis: str, folder: Path, kind: Any, seconds: float | None, seed: int, live: bool, yes: bool,
    socket_path: Path,
) -> Answer:  # fmt: skip
    """Move one axis open loop through its stroke and record voltage, strain gauge and stage at 1 kHz; the others rest.

    The excitation stays inside the voltage and slew limits of the axis' output, starts and ends softly, and
    any fault ends it with a ramp to the park voltage; then nothing is written. Exit code 1 also where the gauge falls
    while the voltage rises, whose recording stays.
    """
    from micromanip.design.data import moves_against
    from micromanip.design.identify.experiments import DEFAULT_SECONDS, design, held, recording, samples_for, write_csv
    from micromanip.settings.check import prepare

    prepared = prepare(config)
    configuration = prepared.configuration
    require_axis(axis, configuration.axes, f" in {config}")
    file = folder / f"{axis}_{kind}.csv"
    require_new(file, "--out")
    excitation = design(configuration, axis, kind, seconds or DEFAULT_SECONDS[kind], seed)
    samples = samples_for(configuration, excitation)
    duration_s = len(samples) / configuration.loop.rate_hz
    real = prepared.wiring.real
    with results_folder(folder):
        if real and not yes:
            low, high = excitation.samples.min(), excitation.samples.max()
            question = f"Axis {axis} will move: {low:.0f} to {high:.0f} V for {duration_s:.0f} s on driver {real[0]}."
            click.confirm(f"{question} Is the spindle free?", abort=True, err=True)
        try:
            rows = _played(prepared, samples, duration_s, socket_path, live=live or not prepared.wiring.virtual)
        except CheckFailed as problem:
            raise CheckFailed(f"{sentence(problem)} Nothing is written") from problem
        series = recording(configuration, excitation, rows)
        if old := int(held(configuration, axis, rows).sum() if f"stage_{axis}" in configuration.signals else 0):
            echo(
                f"warning: signals.stage_{axis} gave no usable sample for {old / configuration.loop.rate_hz:.2g} s of "
                f"{duration_s:.2g} s: stage_um is nan there; `micromanip device probe {config}` shows what it says",
                err=True,
            )
        write_csv(file, series)
    low, high, names = series.y.min(), series.y.max(), ["t_s", *series.names]
    wrong_way = moves_against(series.y, series.u)

    def show() -> None:
        echo(f"{file}: {len(series)} rows, {', '.join(names)}; stroke {low:.1f} to {high:.1f} um")
        if not wrong_way:
            echo(f"next: micromanip fit hysteresis {file} --input voltage_V --output strain_um --burn-in 1")

    failed = CheckFailed(
        f"axis {axis}: the strain gauge falls while the voltage rises: the wrong way, feedback would run away; swap "
        f"the gauge's leads, or change the sign of its scale (signals.strain_{axis}), and record again. This recording "
        f"stays in {file}"
    )
    document = {"file": str(file), "rows": len(series), "columns": names, "stroke_um": high - low}
    return Answer(document, show, failed if wrong_way else None)


def _played(
    prepared: Prepared, samples: NDArray[np.float64], duration_s: float, socket_path: Path, *, live: bool
) -> NDArray[Any]:
    """Rows of `samples` played in open loop; raises CheckFailed where a fault ended that."""
    from micromanip.design.experiment import open_loop

    configuration = open_loop(prepared.configuration)
    if live:
        from .live_experiment import LiveCell

        with tempfile.TemporaryDirectory(prefix="micromanip-") as folder:
            cell = LiveCell(prepared, socket_path, Path(folder))
            try:
                return cell.play(configuration, duration_s, samples)
            except KeyboardInterrupt:
                raise CheckFailed("the experiment was cut short") from None
            finally:
                cell.end()
    from micromanip.virtual.experiment import VirtualExperiment

    from .progress import steps

    with steps() as bar:
        return VirtualExperiment(prepared, say=bar.say)(configuration, duration_s, samples)
