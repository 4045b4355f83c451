"""``micromanip fit hysteresis``: a hysteresis model and its inverse from a recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import CheckFailed, MicromanipError

from .echo import echo
from .options import Answer, Quantity, subcommand
from .progress import steps
from .recording_options import Target, echo_sources, recording_options
from .results import out_option, page_in

if TYPE_CHECKING:
    from micromanip.recordings import TimeSeries

KINDS = ("pi-affine", "pi-tanh", "pi-free", "rate", "network", "best")


@subcommand("hysteresis", "micromanip fit hysteresis x.csv --input voltage_V --output strain_um --burn-in 1")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option("--input", "input_name", required=True, metavar="NAME[:unit]", help="Column of the voltage.")
@click.option("--output", "output_name", required=True, metavar="NAME[:unit]", help="Column of the displacement.")
@recording_options
@click.option("--dt", "step_s", type=Quantity("Seconds"), help="Sampling interval, s, without a time column.")
@click.option(
    "--burn-in",
    "burn_in_s",
    type=Quantity("SecondsOrZero"),
    default=0.0,
    help="Seconds at the start that don't count: a record that begins in mid-loop needs a full period.",
)
@click.option("--model", "kind", type=click.Choice(KINDS), default="best")
@click.option("--creep/--no-creep", default=False, help="Add creep operators (best tries both).")
@click.option("--plays", type=click.IntRange(1, 32), default=10, help="Play operators.")
@click.option("--seed", type=Quantity("Seed"), default=0, help="Of the starts.")
@out_option("the page fit.html")
def command(
    file: Path, input_name: str, output_name: str, time_name: str | None, cut: tuple[float, float] | None,
    rate_hz: float | None, keep_spikes: bool, step_s: float | None, burn_in_s: float, kind: str, creep: bool,
    plays: int, seed: int, validate: Path | None, folder: Path | None, into: Path | None, axis: str | None,

) -> Answer:  # fmt: skip
    """Fit a hysteresis model to FILE (CSV or other text, .mat, .npy, .npz, HDF5, Parquet) and judge it.

    Units are those of the columns' names, a row of units, or given with the name (x:mm); lengths are turned into um.
    Errors are in percent of the record's stroke after the burn-in; on the validation record the offset is refitted.
    Exit code 1 where the data is unusable, with what to record instead.
    """
    from micromanip.design.data import load_record
    from micromanip.design.identify.fitting import Request, fit_record
    from micromanip.recordings import Wanted
    from micromanip.recordings.loader import NO_TIME
    from micromanip.settings.write import with_hysteresis

    target = Target.of(into, axis)
    range_um = None if target is None else target.configuration.axes[target.axis].setpoint.range_um
    timed = time_name or (None if step_s is None else NO_TIME)
    meant = ("voltage", "length")
    wanted = Wanted((input_name, output_name), timed, step_s, cut, rate_hz, meant, bridge=not keep_spikes)
    record = load_record(file, wanted)
    if range_um is not None:
        _require_meant(record, range_um, f"axis {axis} of {into}")
    # the part is that of FILE; the other record has its own length
    held_out = load_record(validate, replace(wanted, cut=None)) if validate else None
    echo_sources([record, *([held_out] if held_out else [])])
    with page_in(folder, "fit.html") as page, steps() as bar:
        bar.say(f"fitting {kind}")
        request = Request(kind, creep, plays, seed, burn_in_s, range_um)
        result = fit_record(record, held_out, request, lambda what: bar.say(f"fitting {what}"))
        if folder is not None:
            from micromanip.design.plots.findings import fit_sections

            bar.say("drawing")
            page.write(f"Fit of {file}", fit_sections(result, record, held_out))
    unwritten = None
    if target is not None:
        try:
            # the set-point may go a little further than the record did: the model is continued there
            whole = result.settings.model_copy(update={"range_um": range_um})
            target.write(with_hysteresis(target.source.text, target.axis, whole))
        except MicromanipError as problem:
            unwritten = problem
    report = result.report() | {"page": page.name}
    report["notes"] = [*record.notes, *report["notes"]]

    def show() -> None:
        _print(report, result.notes)
        page.echo()
        if into is not None and unwritten is None:
            echo(f"written into {into}")

    return Answer(report, show, unwritten or page.problem)


def _require_meant(record: TimeSeries, range_um: tuple[float, float], where: str) -> None:
    """What a stage will be moved by is in stated units, and of its range: continued, but not by more than was seen."""
    for name, unit, base in zip(record.names, record.units, ("V", "um"), strict=True):
        if unit is None:
            raise CheckFailed(
                f"{record.file}: {name} states no unit, and --into takes none for granted: write {name}:{base}"
            )
    low, high = float(record.y.min()), float(record.y.max())
    if range_um[0] < low - (high - low) or range_um[1] > high + (high - low):
        raise CheckFailed(
            f"{record.file}: {record.names[1]} goes from {low:.4g} to {high:.4g} um, the set-point of {where} from "
            f"{range_um[0]:g} to {range_um[1]:g}: too far beyond the record. Record the range that is "
            f"used, or correct the unit, as in {record.names[1]}:mm; nothing is written"
        )


def _print(report: dict[str, Any], notes: list[str]) -> None:
    echo(f"{report['model']}: rms {report['rms_percent']:.3f} %, maximum {report['max_percent']:.2f} % of the stroke")
    if report["validation"]:
        figures = report["validation"]
        echo(f"not fitted to: rms {figures['rms_percent']:.3f} %, maximum {figures['max_percent']:.2f} %")
    for note in notes:
        echo(f"note: {note}")
    for candidate in report["candidates"]:
        echo(
            f"  tried {candidate['model']:16} {candidate['rms_percent']:.3f} % fitted, "
            f"{candidate['held_out_percent']:.3f} % on the part left out"
        )
    for name, value in report["parameters"].items():
        echo(f"  {name}: {_shown(value)}")


def _shown(value: Any) -> str:
    if isinstance(value, list):
        if value and isinstance(value[0], list):
            return f"{len(value)} rows of {len(value[0])}"
        return ", ".join(_shown(entry) for entry in value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)
