"""``micromanip learn``: what repeats of the path error from part to part, and a correction that takes it off."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client
from micromanip.errors import CheckFailed, UsageError, system_error

from .options import (
    Quantity,
    StrictCommand,
    StrictGroup,
    json_option,
    prepare_and_warn,
    print_answer,
    print_json,
    socket_option,
)
from .prose import say

if TYPE_CHECKING:
    from micromanip.design.learning.law import Update
    from micromanip.design.learning.learner import Learner
    from micromanip.design.learning.memory import Learned, Memory
    from micromanip.design.learning.trial import AxisTrial
    from micromanip.status_reply import LearningStatus

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
@click.option("--axis", "only", default="all", show_default=True, help="One axis, or all.")
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
                say(_sentence(each))
    if as_json:
        print_json({"updates": told})


@command.command("status", cls=StrictCommand, epilog="Example: micromanip learn status --memory out/learned")
@running_or_memory_option
@socket_option
@json_option
def status(folder: Path | None, socket_path: Path, as_json: bool) -> None:
    """What each axis has learned, from how many parts, at which frequencies; without --memory the running cell's."""
    from .tables import Figures, out_console

    if folder is None:
        with Client(socket_path) as client:
            print_answer(client.learn_status(), _print_running, as_json)
        return
    found = [_status(memory) for memory in _memories(folder)]
    if as_json:
        print_json({"memory": str(folder), "axes": found})
        return
    shown = Figures(
        "axis", "tool", "parts", "state", "learned, Hz", "correction, um", "wrong is left", "last part, um", "was"
    )
    for each in found:
        last = each["story"][-1] if each["story"] else None
        shown.add_row(
            each["axis"], str(each["tool"] or ""), str(each["parts"]), str(each["generation"]),
            _bands(each["learned_Hz"]),
            f"{each['correction_um']:.3f}", f"{100 * each['contraction']:.2g} %",
            "" if last is None else _interval(last["error_um"], (last["error_least_um"], last["error_most_um"])),
            "" if last is None else last["verdict"],
        )  # fmt: skip
    out_console().print(shown)


@command.command("reset", cls=StrictCommand, epilog="Example: micromanip learn reset --memory out/learned --axis x")
@running_or_memory_option
@click.option("--axis", "only", default="all", show_default=True, help="One axis, or all.")
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
@click.option("--axis", required=True, help="The axis.")
@click.option("--tool", type=Quantity("Count", most=65535), metavar="N", help="Of this tool.  [default: of none]")
@click.option("--to", "file", type=click.Path(path_type=Path), required=True, metavar="FILE", help="CSV file.")
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
@click.argument("config", type=click.Path(path_type=Path), metavar="CONFIG")
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

    from .progress import steps

    prepared = prepare_and_warn(config)
    with steps() as bar:
        found = trial(prepared, parts, seconds, seed, limit_um, bar.say)
    if as_json:
        axes = [axis.document() for axis in found]
        print_json({"config": str(config), "seconds": seconds, "seed": seed, "axes": axes})
    else:
        _print(found)


def _learn_from(
    file: Path, only: str, learner: Learner, begin_s: float | None, seconds: float | None, step: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Learn from one recording, and write what each axis knows then."""
    from micromanip.recordings import open_telemetry

    telemetry = open_telemetry(file)
    if only != "all" and only not in telemetry.axes:
        raise UsageError(f"there is no axis {only} in {file}; its axes are {', '.join(telemetry.axes)}")
    found = learner.update(telemetry, telemetry.axes if only == "all" else [only], begin_s, seconds, step)
    try:
        learner.write(found)
    except OSError as problem:
        raise system_error(problem, learner.folder) from None
    return [_updated(file, name, each) for name, each in found.items()]


def _memories(folder: Path) -> list[Memory]:
    from micromanip.design.learning.memory import read_memory

    if not folder.is_dir():
        raise CheckFailed(f"{folder}: no such folder")
    return [memory for file in sorted(folder.glob("*.npz")) if (memory := read_memory(file)) is not None]


def _print_running(told: LearningStatus) -> None:
    from .tables import Figures, out_console

    say(f"{told['state']}, {told['made']} parts made, memories in {told['folder']}")
    shown = Figures("axis", "memory", "now", "off the path, um", "last part, um", "without, um", "was", "learned, Hz")
    for name, axis in told["axes"].items():
        last = axis["last"] or {}
        memory = "none" if axis["generation"] is None else f"state {axis['generation']}"
        shown.add_row(
            name, memory if axis["may_play"] or axis["generation"] is None else f"{memory}, not played", axis["state"],
            f"{axis['apart_um']:.2f}", *(f"{last[key]:.3f}" if last else "" for key in ("error_um", "without_um")),
            last.get("verdict", ""), _bands(last["learned_Hz"]) if last else "",
        )  # fmt: skip
    out_console().print(shown)


def _learned(now: Learned) -> dict[str, Any]:
    return {
        "parts": now.parts,
        "learned_Hz": [list(band) for band in now.learned_Hz],
        "correction_um": float(abs(now.correction_um).max()),
        "contraction": now.contraction,
    }


def _status(memory: Memory) -> dict[str, Any]:
    return {
        "axis": memory.axis, "cell": memory.cell, "tuning": memory.tuning, "path": memory.path,
        "tool": memory.tool, "temperature_C": memory.temperature_C, "seconds": memory.seconds,
        "generation": memory.generation, **_learned(memory.now),
        "story": [dict(each) for each in memory.story],
    }  # fmt: skip


def _updated(file: Path, axis: str, found: Update) -> dict[str, Any]:
    return {
        "file": str(file), "axis": axis, "verdict": found.verdict, "forgotten": found.forgotten,
        "error_um": found.error_um, "error_95_um": list(found.interval_um),
        "missed_percent": found.memory.story[-1]["missed_percent"], **_learned(found.memory.now),
    }  # fmt: skip


def _sentence(told: dict[str, Any]) -> str:
    begin = (
        f"{told['file']}: axis {told['axis']}: {_interval(told['error_um'], told['error_95_um'])} um rms in the band "
        f"that is learned, {told['missed_percent']:.2g} % of the cycles missed, {told['verdict']}"
    )
    if told["forgotten"]:
        return f"{begin}: forgotten, back to what was played before"
    if not told["learned_Hz"]:
        return f"{begin}; nothing repeats beyond doubt in {told['parts']} part{'s' * (told['parts'] > 1)}"
    return (
        f"{begin}; learned {_bands(told['learned_Hz'])} Hz from {told['parts']} parts, correction up to "
        f"{told['correction_um']:.3f} um; at most {100 * told['contraction']:.2g} % of what is wrong in it stays"
    )


def _interval(value: float, ends: Sequence[float]) -> str:
    return f"{value:.3f} ({ends[0]:.3f} to {ends[1]:.3f})"


def _bands(bands: Sequence[Sequence[float]]) -> str:
    return ", ".join(f"{low:.3g}-{high:.3g}" for low, high in bands) or "nothing"


def _print(found: Sequence[AxisTrial]) -> None:
    from .tables import Figures, out_console

    numbers = [f"part {k + 1}" for k in range(len(found[0].parts))]
    whole = Figures("axis", "uncompensated", *numbers, "floor", "over it", title="True path error, um rms")
    repeats = Figures("axis", *numbers, title="What of it repeats, um rms")
    for axis in found:
        last = axis.parts[-1]
        whole.add_row(
            axis.axis, f"{axis.uncompensated_um:.1f}", *(f"{each.whole_um:.3f}" for each in axis.parts),
            f"{last.floor_um:.3f}", f"{last.over_floor:.3f}",
        )  # fmt: skip
        repeats.add_row(axis.axis, *(f"{each.repeats_um:.3f}" for each in axis.parts))
    out_console().print(whole)
    out_console().print(repeats)
    for axis in found:
        verdicts = ", ".join(each.verdict for each in axis.parts)
        say(f"axis {axis.axis}: learned {_bands(axis.parts[-1].learned_Hz)} Hz; part by part: {verdicts}")
