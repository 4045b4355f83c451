"""``micromanip recording view`` and ``export``: a recording on the scope, and in the formats of other programs."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.extras import required

from .echo import echo
from .options import Messages, StrictCommand, emit_answer, emit_json, json_option
from .recording_options import Cut, open_recording


@click.command(
    "view",
    cls=StrictCommand,
    epilog="Example: micromanip recording view out/run.mcap",
)
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option(
    "--listen", default="127.0.0.1:8091", show_default=True, metavar="HOST:PORT", help="Where browsers find it."
)
@json_option
def view(file: Path, listen: str, as_json: bool) -> None:
    """Show a recording of ours, MCAP or HDF5, as the scope shows a running cell.

    Zoom from 1 ms to the whole file, spectrum, x-y, states, faults and remarks. Of a long file it makes an overview
    meanwhile, which is kept in the user's cache; browsers of this computer need no token. It needs the extra `gateway`.
    """
    with required("recording view", "gateway"):
        from micromanip.gateway.viewing import view as view_file
    messages = Messages()
    view_file(file, listen, messages)
    if as_json:
        emit_json({"file": str(file), "listen": listen, "messages": messages})


@click.command(
    "export",
    cls=StrictCommand,
    epilog="Example: micromanip recording export run.mcap --to part.csv --cut 2:3 --signals strain_um,voltage_V_x",
)
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option(
    "--to",
    "--out",
    "to",
    required=True,
    type=click.Path(path_type=Path),
    help="New file: .csv, .mat, .npz, .h5 or .parquet.",
)  # fmt: skip
@click.option("--cut", type=Cut(), help="This part only, FROM:TO in seconds from the first cycle.")
@click.option("--signals", help="These columns only, between commas; without the axis, those of all axes.")
@json_option
def export(file: Path, to: Path, cut: tuple[float, float] | None, signals: str | None, as_json: bool) -> None:
    """Write a recording to another format; every number keeps its bits.

    .h5 and .parquet need the extra `formats`.
    """
    from micromanip.recordings.export import export as export_to

    chosen = [name.strip() for name in (signals or "").split(",") if name.strip() not in ("", "t_s")]
    telemetry = open_recording(file)
    done = export_to(telemetry, to, cut, chosen)
    emit_answer(
        {"file": str(done.file), "rows": done.rows, "columns": done.columns, "bytes": done.bytes},
        lambda _: echo(f"{done.rows} cycles to {done.file}, {done.bytes / 1e6:.1f} MB"),
        as_json,
    )
