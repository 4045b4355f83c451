"""``micromanip learn``: what repeats of the path error from part to part, and a correction that takes it off."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client

from .echo import echo
from .options import Answer, axis_option, client_command, subcommand
from .results import require_new

if TYPE_CHECKING:
    from micromanip.status_reply import LearningStatus


@subcommand("part", "micromanip learn part begin")
@click.argument("what", type=click.Choice(["begin", "end"]))
@client_command(lambda _: echo("taken"))
def part(what: str) -> Callable[[Client], dict[str, bool]]:
    """Let a part begin or end now, for cells without the signal `part`.

    The correction is played from the cycle in which the loop takes the command: a program that starts the robot's path
    sends it, with the same delay each time.
    """
    return lambda client: _accepted(client.learn_part_begin if what == "begin" else client.learn_part_end)


@subcommand("status", "micromanip learn status")
@client_command(lambda told: _print_status(told))
def status() -> Callable[[Client], LearningStatus]:
    """Show what each axis has learned, from how many parts, at which frequencies, and what is played."""
    return lambda client: client.learn_status()


@subcommand("reset", "micromanip learn reset --axis x")
@axis_option
@client_command(lambda _: echo("forgotten; what was played has faded out"))
def reset(only: str) -> Callable[[Client], dict[str, bool]]:
    """Forget the memories of an axis, damaged ones too, or those of all; what is played of them fades out first."""
    return lambda client: _accepted(lambda: client.learn_reset(*([] if only == "all" else [only])))


@subcommand("export", "micromanip learn export ~/.local/state/micromanip/learned/x.npz x.csv")
@click.argument("memory", type=click.Path(path_type=Path))
@click.argument("file", type=click.Path(path_type=Path))
def export(memory: Path, file: Path) -> Answer:
    """Write a MEMORY as the CSV file FILE: t_s, path_um, error_um, correction_um.

    `micromanip learn status` names the folder of the memories. There is a file for each axis, and for each tool.
    """
    from micromanip.design.learning.memory import read_memory

    found = read_memory(memory)
    require_new(file, "FILE")
    with file.open("w", newline="", encoding="utf-8") as opened:
        rows = csv.writer(opened)
        rows.writerow(["t_s", "path_um", "error_um", "correction_um"])
        for k, values in enumerate(zip(found.path_um, found.mean_um, found.correction_um, strict=True)):
            rows.writerow([f"{k / found.rate_hz:.6g}", *(f"{value:.7g}" for value in values)])
    document = {"file": str(file), "rows": len(found.path_um), "axis": found.axis, "parts": found.parts}
    return Answer(document, lambda: echo(f"wrote {file}"))


def _accepted(order: Callable[[], None]) -> dict[str, bool]:
    order()
    return {"accepted": True}


def _print_status(told: Any) -> None:
    """The running cell's learning (of LearningStatus), a row for each axis."""
    from .tables import print_table

    echo(f"{told['state']}, {told['made']} parts made, memories in {told['folder']}")
    rows = []
    for name, axis in told["axes"].items():
        last: dict[str, Any] = axis["last"] or {}
        memory = "none" if axis["generation"] is None else f"state {axis['generation']}"
        rows.append((
            name, memory if axis["may_play"] or axis["generation"] is None else f"{memory}, not played", axis["state"],
            f"{axis['apart_um']:.2f}", *(f"{last[key]:.3f}" if last else "" for key in ("error_um", "without_um")),
            last.get("verdict", ""), _bands(last["learned_Hz"]) if last else "",
        ))  # fmt: skip
    columns = ("axis", "memory", "now", "off the path, um", "last part, um", "without, um", "was", "learned, Hz")
    print_table(columns, rows)


def _bands(bands: Sequence[Sequence[float]]) -> str:
    return ", ".join(f"{low:.3g}-{high:.3g}" for low, high in bands) or "nothing"
