"""``micromanip learn``: a part begins or ends; what was learned of the parts so far, and how it is forgotten."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client
from micromanip.errors import CheckFailed, UsageError, system_error

from .axes import axis_option, one_axis_option
from .echo import echo
from .learned import memory_answer, print_memories, print_running
from .options import Quantity, StrictCommand, client_command, emit_answer, emit_json, json_option, socket_option

if TYPE_CHECKING:
    from micromanip.design.learning.memory import Memory

memory_option = click.option(
    "--memory", "folder", type=click.Path(path_type=Path, file_okay=False), metavar="DIR", required=True,
    help="Folder of the memories, a file for each axis.",
)  # fmt: skip
running_or_memory_option = click.option(
    "--memory", "folder", type=click.Path(path_type=Path, file_okay=False), metavar="DIR",
    help="Folder of the memories.  [default: those of the running controller]",
)  # fmt: skip


def _show_part(answer: dict[str, Any]) -> None:
    echo("a part begins" if answer["part"] == "begin" else "the part has ended")


@click.command("part", cls=StrictCommand, epilog="Example: micromanip learn part begin --tool 3")
@click.argument("what", type=click.Choice(["begin", "end"]))
@click.option(
    "--tool", type=Quantity("Count", most=65_535), metavar="N",
    help="With begin, the tool in the spindle: what was learned with it is played.  [default: none is told]",
)  # fmt: skip
@client_command(_show_part)
def part(what: str, tool: int | None) -> Callable[[Client], dict[str, Any]]:
    """Tell the running controller that a part begins or ends now: the tracker's path says when exactly.

    At its end, also where it was broken off, what is played for it fades out. Not where the configuration has the
    signal `part`: then the machine says it.
    """
    if what == "end" and tool is not None:
        raise UsageError("--tool goes with `begin`")

    def order(client: Client) -> dict[str, Any]:
        if what == "begin":
            client.part_begin(tool)
        else:
            client.part_end()
        return {"accepted": True, "part": what}

    return order


@click.command("status", cls=StrictCommand, epilog="Example: micromanip learn status --memory out/learned")
@running_or_memory_option
@socket_option
@json_option
def status(folder: Path | None, socket_path: Path, as_json: bool) -> None:
    """What each axis has learned, from how many parts, at which frequencies; without --memory the running cell's."""
    if folder is None:
        with Client(socket_path) as client:
            emit_answer(client.learn_status(), print_running, as_json)
        return
    found = [memory_answer(memory) for memory in _memories(folder)]
    if as_json:
        emit_json({"memory": str(folder), "axes": found})
        return
    print_memories(found)


@click.command("reset", cls=StrictCommand, epilog="Example: micromanip learn reset --memory out/learned --axis x")
@running_or_memory_option
@axis_option
@socket_option
@json_option
def reset(folder: Path | None, only: str, socket_path: Path, as_json: bool) -> None:
    """Forget: remove the memory of an axis, a damaged one too, or those of all; other files stay.

    Without --memory that of the running cell: what it plays fades out first.
    """
    from micromanip.design.learning.memory import memory_file, memory_files, remove_memory

    if folder is None:
        with Client(socket_path) as client:
            client.learn_reset(*([] if only == "all" else [only]))
        emit_answer({"accepted": True}, lambda _: echo("forgotten; what was played has faded out"), as_json)
        return
    if only == "all":
        files = [
            file for axis in sorted({each.axis for each in _memories(folder)}) for file in memory_files(folder, axis)
        ]
    else:
        files = memory_files(folder, only) or [memory_file(folder, only)]
    for file in files:
        remove_memory(file)
    if as_json:
        emit_json({"removed": [str(file) for file in files]})
    else:
        for file in files:
            echo(f"removed {file}")


@click.command(
    "export", cls=StrictCommand, epilog="Example: micromanip learn export --memory out/learned --axis x --to x.csv"
)
@memory_option
@one_axis_option
@click.option("--tool", type=Quantity("Count", most=65535), metavar="N", help="Of this tool.  [default: of none]")
@click.option("--to", "--out", "file", type=click.Path(path_type=Path), required=True, metavar="FILE", help="CSV file.")
@json_option
def export(folder: Path, axis: str, tool: int | None, file: Path, as_json: bool) -> None:
    """Write path, error and correction of an axis as CSV: t_s, path_um, error_um, correction_um."""
    from micromanip.design.learning.memory import memory_file, read_memory

    memory = read_memory(memory_file(folder, axis, tool or 0))
    if memory is None:
        raise CheckFailed(f"{memory_file(folder, axis, tool or 0)}: no such memory")
    if file.exists():
        raise UsageError(f"--to {file} is there already: nothing is replaced; name another file")
    now = memory.now
    try:
        with file.open("w", newline="", encoding="utf-8") as opened:
            rows = csv.writer(opened)
            rows.writerow(["t_s", "path_um", "error_um", "correction_um"])
            for k, values in enumerate(zip(memory.path_um, now.mean_um, now.correction_um, strict=True)):
                rows.writerow([f"{k / memory.rate_hz:.6g}", *(f"{value:.7g}" for value in values)])
    except OSError as problem:
        raise system_error(problem, file) from None
    if as_json:
        emit_json({"file": str(file), "rows": len(memory.path_um)})
    else:
        echo(f"wrote {file}")


def _memories(folder: Path) -> list[Memory]:
    from micromanip.design.learning.memory import read_memory

    if not folder.is_dir():
        raise CheckFailed(f"{folder}: no such folder")
    return [memory for file in sorted(folder.glob("*.npz")) if (memory := read_memory(file)) is not None]
