"""``micromanip explain``: a trip in plain words, from its black box."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from micromanip.errors import UsageError, system_error

from .options import StrictCommand, json_option, print_json
from .prose import say

if TYPE_CHECKING:
    from micromanip.host.trips.store import Box


@click.command("explain", cls=StrictCommand, epilog="Example: micromanip explain --plot trip.png")
@click.argument("trip", required=False)
@click.option("--list", "listed", is_flag=True, help="List all trips instead, the newest last.")
@click.option("--plot", type=click.Path(path_type=Path, dir_okay=False), help="Draw it into this .png or .svg file.")
@click.option(
    "--trips",
    "folder",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the trips.  [default: /var/lib/micromanip/trips, or as for run]",
)
@json_option
def command(trip: str | None, listed: bool, plot: Path | None, folder: Path | None, as_json: bool) -> None:
    """What tripped, the order of causes, what the controller did, and what to do next.

    TRIP is a file, or the name of a trip or its beginning; without it, the newest.
    """
    from micromanip.host.trips.report import lines, story
    from micromanip.host.trips.store import Box, find, folder_to_read, summary, trips

    folder = folder or folder_to_read()
    if listed:
        if trip is not None or plot is not None:
            raise UsageError("--list shows all trips: leave out TRIP and --plot")
        found = [summary(file) for file in trips(folder)]
        if as_json:
            print_json(found)
            return
        for entry in found:
            say(f"{entry['trip']}  {entry['seen']}")
        if not found:
            say(f"no trips in {folder}")
        return
    if plot is not None and plot.suffix.lower() not in (".png", ".svg"):
        raise UsageError(f"--plot {plot}: the file must end with .png or .svg")
    file = find(folder, trip)
    box = Box.load(file)
    told = story(box, file)
    if plot is not None:
        _draw(box, plot)
        told["plot"] = str(plot)
    if as_json:
        print_json(told)
        return
    for line in lines(told):
        say(line)


def _draw(box: Box, plot: Path) -> None:
    from micromanip.host.trips.report import save

    try:
        save(box, plot)
    except OSError as problem:
        raise system_error(problem, f"--plot {plot} can't be written") from problem
