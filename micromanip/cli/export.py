"""``micromanip export``: a recording in the formats of other programs."""

from __future__ import annotations

from pathlib import Path

import click

from .options import StrictCommand, json_option, print_answer
from .prose import say
from .recording_options import Cut, warn_of_damage


@click.command(
    "export",
    cls=StrictCommand,
    epilog="Example: micromanip export run.mcap --to part.csv --cut 2:3 --signals strain_um,voltage_V_x",
)
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option(
    "--to",
    "--out",
    "to",
    required=True,
    type=click.Path(path_type=Path),
    help="New file: .h5, .parquet, .csv, .mat or .npz.",
)
@click.option("--cut", type=Cut(), help="This part only, FROM:TO in seconds from the first cycle.")
@click.option("--signals", help="These columns only, between commas; without the axis, those of all axes.")
@json_option
def command(file: Path, to: Path, cut: tuple[float, float] | None, signals: str | None, as_json: bool) -> None:
    """Write a recording of ours to another format; every number keeps its bits."""
    from micromanip.recordings import open_telemetry
    from micromanip.recordings.export import export

    chosen = [name.strip() for name in (signals or "").split(",") if name.strip() not in ("", "t_s")]
    telemetry = open_telemetry(file)
    done = export(telemetry, to, cut, chosen)
    warn_of_damage(telemetry)
    print_answer(
        {"file": str(done.file), "rows": done.rows, "columns": done.columns, "bytes": done.bytes},
        lambda _: say(f"{done.rows} cycles to {done.file}, {done.bytes / 1e6:.1f} MB"),
        as_json,
    )
