"""``micromanip learn``: what repeats of the path error from part to part, and a correction that takes it off."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client
from micromanip.errors import CheckFailed, UsageError, system_error

from .axes import axis_option, chosen_axes
from .axis_names import complete_axis
from .learned import memory_answer, print_memories, print_running, print_trials, update_answer, update_sentence
from .options import (
    Quantity,
    StrictCommand,
    StrictGroup,
    config_argument,
    json_option,
    print_answer,
    print_json,
    socket_option,
)
from .prose import say

if TYPE_CHECKING:
    from micromanip.design.learning.learner import Learner
    from micromanip.design.learning.memory import Memory

memory_option = click.option(
    "--memory", "folder", type=click.Path(path_type=Path, file_okay=False), metavar="DIR", required=True,
    help="Folder of the memories, a file for each axis.",
)  # fmt: skip
running_or_memory_option = click.option(
    "--memory", "folder", type=click.Path(path_type=Path, file_okay=False), metavar="DIR",
    help="Folder of the memories.  [default: those of the running controller]",
)  # fmt: skip
limit_option = click.option(
    "--limit", "limit_um", type=Quantity("Distance", least=0.01, most=50.0), default=5.0, show_default=True,
    metavar="UM", help="A correction that would be larger is not applied.",
)  # fmt: skip


@click.group("learn", cls=StrictGroup, epilog="Example: micromanip learn try config/simulated.yaml")
def command() -> None:
    """Learn from part to part what of the path error repeats, and a correction for it.

    docs/learning.md explains it.
    """


@command.command(
    "update",
    cls=StrictCommand,
    epilog="Example: micromanip learn update part1.mcap part2.mcap --memory out/learned --begin 2 --seconds 8",
)
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="RECORDING...")
@memory_option
@axis_option
@click.option(
    "--begin", "begin_s", type=Quantity("SecondsOrZero"), metavar="S",
    help="When the part begins, after tracking has.  [default: as in the memory]",
)  # fmt: skip
@click.option(
    "--seconds", type=Quantity("Seconds"), metavar="S", help="How long the part takes.  [default: as in the memory]"
)
@click.option(
    "--search", "search_s", type=Quantity("SecondsOrZero", most=60.0), default=0.5, show_default=True, metavar="S",
    help="The path is looked for so far from where it began before.",
)  # fmt: skip
@click.option(
    "--tolerance", "tolerance_um", type=Quantity("Distance"), metavar="UM",
    help="How far it may be from the memory's path, rms.  [default: 1 %, at least .5]",
)  # fmt: skip
@limit_option
@json_option
def update(
    files: tuple[Path, ...], folder: Path, only: str, begin_s: float | None, seconds: float | None, search_s: float,
    tolerance_um: float | None, limit_um: float, as_json: bool,
) -> None:  # fmt: skip
    """Learn from recordings, one part in each, in their order.

    A part that is worse than the one before, beyond doubt, leads back to what was played before it. Whatever does not
    belong to the memory (another cell, tuning or path, a part that was not finished) is refused, and changes nothing.
    """
    from micromanip.design.learning.learner import Learner

    from .progress import steps
    from .results import results_folder

    learner = Learner(folder, limit_um, search_s, tolerance_um)
    told: list[dict[str, Any]] = []
    try:
        with results_folder(folder, "--memory"), steps() as bar:
            for file in files:
                told += _learn_from(file, only, learner, begin_s, seconds, bar.say)
    finally:  # of what was learned before something is refused, too
        if not as_json:
            for each in told:
                say(update_sentence(each))
    if as_json:
        print_json({"updates": told})


@command.command("status", cls=StrictCommand, epilog="Example: micromanip learn status --memory out/learned")
@running_or_memory_option
@socket_option
@json_option
def status(folder: Path | None, socket_path: Path, as_json: bool) -> None:
    """What each axis has learned, from how many parts, at which frequencies; without --memory the running cell's."""
    if folder is None:
        with Client(socket_path) as client:
            print_answer(client.learn_status(), print_running, as_json)
        return
    found = [memory_answer(memory) for memory in _memories(folder)]
    if as_json:
        print_json({"memory": str(folder), "axes": found})
        return
    print_memories(found)


@command.command("reset", cls=StrictCommand, epilog="Example: micromanip learn reset --memory out/learned --axis x")
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
        print_answer({"accepted": True}, lambda _: say("forgotten; what was played has faded out"), as_json)
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
        print_json({"removed": [str(file) for file in files]})
    else:
        for file in files:
            say(f"removed {file}")


@command.command(
    "export", cls=StrictCommand, epilog="Example: micromanip learn export --memory out/learned --axis x --to x.csv"
)
@memory_option
@click.option("--axis", required=True, shell_complete=complete_axis, help="The axis.")
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
        print_json({"file": str(file), "rows": len(memory.path_um)})
    else:
        say(f"wrote {file}")


@command.command("try", cls=StrictCommand, epilog="Example: micromanip learn try config/simulated.yaml --parts 5")
@config_argument
@click.option("--parts", type=Quantity("Count", least=2, most=50), default=5, show_default=True, help="Parts in a row.")
@click.option(
    "--seconds", type=Quantity("Seconds", least=2.0, most=600.0), default=8.0, show_default=True, metavar="S",
    help="How long each takes, once the tool is in.",
)  # fmt: skip
@click.option("--seed", type=Quantity("Seed"), default=1, show_default=True, help="Draws the noise of each part.")
@limit_option
@json_option
def try_(config: Path, parts: int, seconds: float, seed: int, limit_um: float, as_json: bool) -> None:
    """Make identical parts on a simulated cell in virtual time, which learns from each, and say what is left."""
    from micromanip.design.learning.trial import trial
    from micromanip.settings.check import prepare

    from .progress import steps

    prepared = prepare(config)
    with steps() as bar:
        found = trial(prepared, parts, seconds, seed, limit_um, bar.say)
    if as_json:
        axes = [axis.document() for axis in found]
        print_json({"config": str(config), "seconds": seconds, "seed": seed, "axes": axes})
    else:
        print_trials(found)


def _learn_from(
    file: Path, only: str, learner: Learner, begin_s: float | None, seconds: float | None, step: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Learn from one recording, and write what each axis knows then."""
    from micromanip.recordings import open_telemetry

    telemetry = open_telemetry(file)
    found = learner.update(telemetry, chosen_axes(telemetry.axes, only, file), begin_s, seconds, step)
    try:
        learner.write(found)
    except OSError as problem:
        raise system_error(problem, learner.folder) from None
    return [update_answer(file, name, each) for name, each in found.items()]


def _memories(folder: Path) -> list[Memory]:
    from micromanip.design.learning.memory import read_memory

    if not folder.is_dir():
        raise CheckFailed(f"{folder}: no such folder")
    return [memory for file in sorted(folder.glob("*.npz")) if (memory := read_memory(file)) is not None]
