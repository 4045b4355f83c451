"""``micromanip fit linear``: linear dynamics from recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from micromanip.errors import UsageError

from .echo import echo
from .options import Answer, Quantity, subcommand
from .progress import steps
from .recording_options import Target, echo_sources, recording_options


@subcommand("linear", "micromanip fit linear x.csv --input setpoint_um --output stage_um --dt 1e-4")
@click.argument("files", type=click.Path(path_type=Path), metavar="FILE...", nargs=-1, required=True)
@click.option(
    "--input", "inputs", required=True, metavar="COLUMNS",
    help="Columns of the inputs, separated by commas: names, in quotes if need be, or numbers without a header.",
)  # fmt: skip
@click.option("--output", "outputs", required=True, metavar="COLUMNS", help="Columns of the outputs, likewise.")
@recording_options
@click.option(
    "--dt", type=Quantity("Seconds"),
    help="Sampling interval of the model, s: needed without a time column; with one, a whole multiple thins the data.",
)  # fmt: skip
@click.option("--order", type=click.IntRange(1, 60), help="States  [default: chosen up to 12 by the held-out error]")
@click.option(
    "--split", type=Quantity("Positive", least=0.1, most=1.0), default=0.5,
    help="Share of each file, from its start, that is fitted to; the rest is held out. 1 goes with --validate.",
)  # fmt: skip
def command(
    files: tuple[Path, ...], inputs: str, outputs: str, time_name: str | None, cut: tuple[float, float] | None,
    rate_hz: float | None, keep_spikes: bool, dt: float | None, order: int | None, split: float,
    validate: Path | None, into: Path | None, axis: str | None,
) -> Answer:  # fmt: skip
    """Fit a linear model to FILE (CSV or other text, .mat, .npy, .npz, HDF5, Parquet), each an experiment.

    Delays are estimated. The fit of an output is 100 % less the rms error of the free run in percent of the output's
    rms, on the part held out, with state and offset at its start fitted; the strict one fits both to the first tenth
    of that part and is judged on the rest. --into writes axes.AXIS.outer.model: the stage's position by the set-point,
    both in um, recorded with the strain loop closed; `analyse margins` judges it, `commission` tunes to it. Exit code 1
    where the data is unusable.
    """
    from micromanip.design.identify.linear.configured import require_stage, with_model
    from micromanip.design.identify.linear.experiments import load_linear
    from micromanip.design.identify.linear.validated import fit_records
    from micromanip.recordings import Wanted

    for option, columns in (("--input", inputs), ("--output", outputs)):
        if not all(name.strip() for name in columns.split(",")):
            raise UsageError(f"{option} {columns}: a name between commas is empty")
    if split == 1.0 and validate is None:
        raise UsageError("--split 1 leaves nothing to judge the model by: give --validate FILE, or a smaller split")
    target = Target.of(into, axis)
    wanted = Wanted((inputs, outputs), time_name, dt, cut=cut, rate_hz=rate_hz, bridge=not keep_spikes)
    records = [load_linear(file, wanted) for file in files]
    held_out = load_linear(validate, replace(wanted, cut=None)) if validate else None
    echo_sources([*records, *([held_out] if held_out else [])])
    if target is not None:
        require_stage(records[0])
    with steps() as bar:
        bar.say("fitting")
        found = fit_records(records, held_out, order, split, bar.say)
    report = found.report() | {"into": None if into is None else str(into)}
    if target is not None:
        target.write(with_model(target.source, target.axis, found.model))
    read = [note for record in records for note in record.notes]

    def show() -> None:
        _print(report, records[0].names[records[0].inputs :], "held out" if split < 1.0 else "not fitted to")
        if into is not None:
            echo(f"wrote axes.{axis}.outer.model of {into}: `analyse margins` judges the loop, `commission` tunes it")

    return Answer(report | {"notes": [*read, *report["notes"]]}, show)


def _arx1(figures: dict[str, Any], output: int) -> str:
    beside = figures.get("arx1_strict_fit_percent")
    return f", ARX(1) {beside[output]:.2f} %" if beside else ""


def _print(report: dict[str, Any], outputs: Sequence[str], held_out: str) -> None:
    delays = ", ".join(map(str, report["delay_samples"]))
    echo(f"order {report['order']}, delay {delays} samples of {report['dt_s']:.6g} s")
    parts = [(held_out, report)]
    if report["validation"] and held_out == "held out":
        parts.append(("not fitted to", report["validation"]))
    for where, figures in parts:
        for k, name in enumerate(outputs):
            fit, rms, strict = (figures[f"{key}_percent"][k] for key in ("fit", "rms_error", "strict_fit"))
            echo(f"{where}, {name}: fit {fit:.2f} %, rms error {rms:.2f} %")
            echo(f"  started on its first tenth, judged on the rest: fit {strict:.2f} %{_arx1(figures, k)}")
    for note in report["notes"]:
        echo(f"note: {note}")
    for name, coherence in zip(outputs, report["coherence"], strict=True):
        echo(f"coherence of {name}: {coherence:.3f} over all frequencies")
    for pole, hertz, damping in zip(report["poles_z"], report["poles_Hz"], report["poles_damping"], strict=True):
        if pole[1] >= 0.0:
            echo(f"  pole {pole[0]:.5f} {pole[1]:+.5f}j: {hertz:.4g} Hz, damping {damping:.4f}")
    for order, error in report["tried"].items():
        echo(f"  tried order {order}: {error:.3f} % on the part left out")
