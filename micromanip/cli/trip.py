"""``micromanip trip list`` and ``trip show``: trips in plain words, from their black boxes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from micromanip.errors import UsageError, system_error

from .echo import echo
from .options import Answer, subcommand

if TYPE_CHECKING:
    from micromanip.host.trips.store import TripRecord


_folder_option = click.option(
    "--trips", "folder", type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the trips.  [default: /var/lib/micromanip/trips, or as for run]",
)  # fmt: skip


@subcommand("list", "micromanip trip list")
@_folder_option
def list_(folder: Path | None) -> Answer:
    """List all trips, the newest last."""
    from micromanip.host.trips.store import folder_to_read, summary, trips

    folder = folder or folder_to_read()
    found = [summary(file) for file in trips(folder)]
    said = [f"{entry['trip']}  {entry['seen']}" for entry in found] or [f"no trips in {folder}"]
    return Answer(found, lambda: echo("\n".join(said)))


@subcommand("show", "micromanip trip show --plot trip.png")
@click.argument("trip", required=False)
@click.option("--plot", type=click.Path(path_type=Path, dir_okay=False), help="Draw it into this .png or .svg file.")
@_folder_option
def show(trip: str | None, plot: Path | None, folder: Path | None) -> Answer:
    """Show what tripped, the order of causes, what the controller did, and what to do next.

    TRIP is a file, or the name of a trip or its beginning; without it, the newest.
    """
    from micromanip.host.trips.report import lines, story
    from micromanip.host.trips.store import TripRecord, find, folder_to_read

    if plot is not None and plot.suffix.lower() not in (".png", ".svg"):
        raise UsageError(f"--plot {plot}: the file must end with .png or .svg")
    file = find(folder or folder_to_read(), trip)
    box = TripRecord.load(file)
    found = story(box, file)
    if plot is not None:
        _draw(box, plot)
        found["plot"] = str(plot)
    return Answer(found, lambda: list(map(echo, lines(found))))


def _draw(box: TripRecord, plot: Path) -> None:
    from micromanip.host.trips.report import save

    try:
        save(box, plot)
    except OSError as problem:
        raise system_error(problem, f"--plot {plot} can't be written") from problem
