"""``micromanip recording start``, ``stop``, ``mark``, ``list``, ``view``, ``export``: recordings, made and read."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client
from micromanip.errors import UsageError
from micromanip.extras import required
from micromanip.replies import Marked
from micromanip.status_reply import Recorded

from .echo import echo
from .options import Answer, Messages, Quantity, client_command, subcommand
from .recording_options import Cut, open_recording

if TYPE_CHECKING:
    from micromanip.recordings import Telemetry
    from micromanip.recordings.telemetry import Piece


def _show_begun(recorded: Recorded) -> None:
    echo(f"recording to {recorded['file']}")


def _show_ended(recorded: Recorded) -> None:
    size = recorded["bytes"] / 1e6
    echo(f"recorded {recorded['rows']} cycles to {recorded['file']}, {size:.1f} MB, {recorded['dropped']} lost")


def _show_marked(marked: Marked) -> None:
    echo(f"marked cycle {marked['cycle']} in {marked['file']}")


@subcommand("start", "micromanip recording start part17.mcap --before 3")
@click.argument("file", required=False)
@click.option(
    "--before", "before_s", type=Quantity("SecondsOrZero", most=5.0), default=0.0, help="Begin so much earlier, s."
)
@click.option(
    "--segment",
    "minutes",
    type=Quantity("SecondsOrZero", least=0.1, most=1440.0),
    help="Another file each so many minutes.",
)
@click.option(
    "--quota",
    "quota_GB",
    type=Quantity("SecondsOrZero", least=0.001),
    help="Remove the oldest of them beyond so many GB.",
)
@client_command(_show_begun)
def start(
    file: str | None,
    before_s: float,
    minutes: float | None,
    quota_GB: float | None,
) -> Callable[[Client], Recorded]:
    """Begin a recording: FILE.mcap, a name without a folder; named for the time without one.

    It goes to the folder that `run --recordings` names, and replaces nothing there.
    """
    if (minutes is None) != (quota_GB is None):
        raise UsageError("--segment and --quota go together: how long a file is, and how much all may take")
    return lambda client: client.recording_start(
        file,
        before_s=before_s,
        segment_s=None if minutes is None else minutes * 60.0,
        quota_bytes=None if quota_GB is None else round(quota_GB * 1e9),
    )


@subcommand("stop", "micromanip recording stop")
@client_command(_show_ended)
def stop() -> Callable[[Client], Recorded]:
    """End the recording; all that was recorded until now is in the file."""
    return Client.recording_stop


@subcommand("mark", 'micromanip recording mark "coolant on"')
@click.argument("text")
@client_command(_show_marked)
def mark(text: str) -> Callable[[Client], Marked]:
    """Put a remark into the recording, at this cycle."""
    return lambda client: client.recording_mark(text)


@subcommand("view", "micromanip recording view out/run.mcap")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option("--listen", default="127.0.0.1:8091", metavar="HOST:PORT", help="Where browsers find it.")
def view(file: Path, listen: str) -> Answer:
    """Show a recording of ours as the scope shows a running cell.

    Zoom from 1 ms to the whole file, spectrum, x-y, states, faults and remarks. Of a long file it makes an overview
    meanwhile; browsers of this computer need no token. It needs the extra `gateway`.
    """
    with required("recording view", "gateway"):
        from micromanip.gateway.viewing import view as view_file
    messages = Messages()
    view_file(file, listen, messages)
    return Answer({"file": str(file), "listen": listen, "messages": messages})


@subcommand("export", "micromanip recording export run.mcap --to part.csv --cut 2:3 --signals strain_um,voltage_V_x")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option(
    "--to", required=True, type=click.Path(path_type=Path), help="New file: .csv, .mat, .npz, .h5 or .parquet."
)  # fmt: skip
@click.option("--cut", type=Cut(), help="This part only, FROM:TO in seconds from the first cycle.")
@click.option("--signals", help="These columns only, between commas; without the axis, those of all axes.")
def export(file: Path, to: Path, cut: tuple[float, float] | None, signals: str | None) -> Answer:
    """Write a recording to another format; every number keeps its bits.

    .h5 and .parquet need the extra `formats`.
    """
    from micromanip.recordings.export import export as export_to

    chosen = [name.strip() for name in (signals or "").split(",") if name.strip() not in ("", "t_s")]
    telemetry = open_recording(file)
    done = export_to(telemetry, to, cut, chosen)
    return Answer(
        {"file": str(done.file), "rows": done.rows, "columns": done.columns, "bytes": done.bytes},
        lambda: echo(f"{done.rows} cycles to {done.file}, {done.bytes / 1e6:.1f} MB"),
    )


_HEAD = ("recording", "begun (UTC)", "s", "axes", "configuration", "MB", "ended", "marks")
_HASH = 12


@subcommand("list", "micromanip recording list /var/lib/micromanip/recordings")
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False), required=False)
def list_(folder: Path | None) -> Answer:
    """What FOLDER has of recordings, the newest first; without FOLDER those that `recording start` made for this user.

    Each file's head and end are read, not its rows. A file that can't be read is listed with the reason.
    """
    from micromanip.host.recording.recordings import default_folder

    folder = default_folder() if folder is None else folder
    files = [file for file in folder.glob("*") if file.suffix.lower() == ".mcap" and not file.name.startswith(".")]
    rows = sorted(map(_row, files), key=lambda row: (row["began"], row["name"]), reverse=True)
    document = {"folder": str(folder), "recordings": rows}
    return Answer(document, lambda: _show(document))


def _row(file: Path) -> dict[str, Any]:
    """One recording as JSON has it: `began` as ISO 8601, UTC; what is not known is None."""
    from micromanip.errors import CheckFailed
    from micromanip.recordings import open_telemetry

    about = file.lstat()
    row: dict[str, Any] = {
        "name": file.name, "began": _utc(about.st_mtime), "seconds": None, "axes": None, "sha256": None,
        "bytes": about.st_size, "ended": None, "marks": [], "problem": None,
    }  # fmt: skip
    try:
        telemetry = open_telemetry(file)
    except CheckFailed as problem:
        return row | {"problem": str(problem).removeprefix(f"{file}: ")}
    if telemetry.marks:
        row["began"] = datetime.fromisoformat(telemetry.marks[0]["time"]).astimezone(UTC).isoformat(timespec="seconds")
    return row | {
        "seconds": _seconds(telemetry),
        "axes": telemetry.axes,
        "sha256": telemetry.sha256,
        "ended": _ended(telemetry),
        "marks": [mark["text"] for mark in telemetry.marks[1:]],
        "problem": telemetry.damage() or None,
    }


def _utc(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="seconds")


def _ended(telemetry: Telemetry) -> str:
    return "in order" if telemetry.end else "broken off, or still being written"


def _seconds(telemetry: Telemetry) -> float | None:
    """From the first cycle that can be read to the end of the last one."""
    pieces = telemetry.pieces()
    first, last = _cycle(pieces, 0), _cycle(reversed(pieces), -1)
    return None if first is None or last is None else (last - first + 1) * telemetry.period_ns * 1e-9


def _cycle(pieces: Iterable[Piece], place: int) -> int | None:
    """The first or last cycle of the first piece that can be read."""
    from micromanip.errors import CheckFailed

    for piece in pieces:
        try:
            cycles = piece(["cycle"])["cycle"]
        except CheckFailed:
            continue
        if len(cycles):
            return int(cycles[place])
    return None


def _show(document: dict[str, Any]) -> None:
    from rich.markup import escape

    from .tables import print_table

    if not document["recordings"]:
        echo(f"{document['folder']}: no recording (.mcap) in it")
    rows = (
        (
            row["name"], row["began"][:19], "" if row["seconds"] is None else f"{row['seconds']:.1f}",
            " ".join(row["axes"] or ()), (row["sha256"] or "")[:_HASH], f"{row['bytes'] / 1e6:.1f}",
            "; ".join(filter(None, [row["ended"], row["problem"]])), "; ".join(row["marks"]),
        )
        for row in document["recordings"]
    )  # fmt: skip
    print_table(_HEAD, [list(map(escape, row)) for row in rows])
