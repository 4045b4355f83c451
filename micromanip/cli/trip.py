"""``micromanip trip list`` and ``trip show``: trips in plain words, from their black boxes."""

from __future__ import annotations

from pathlib import Path

import click

from .echo import echo
from .options import Answer, subcommand
from .results import Page, require_new_page

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


@subcommand("show", "micromanip trip show --to trip.html")
@click.argument("trip", required=False)
@click.option(
    "--to", type=click.Path(path_type=Path), metavar="FILE.html",
    help="New file: words and plots as one page of HTML.",
)  # fmt: skip
@_folder_option
def show(trip: str | None, to: Path | None, folder: Path | None) -> Answer:
    """Show what tripped, the order of causes, what the controller did, and what to do next.

    TRIP is a file, or the name of a trip or its beginning; without it, the newest.
    """
    from micromanip.host.trips.report import lines, story
    from micromanip.host.trips.store import TripRecord, find, folder_to_read

    from .trip_page import trip_sections

    if to is not None:
        require_new_page(to)
    file = find(folder or folder_to_read(), trip)
    box = TripRecord.load(file)
    found = story(box, file)
    page = Page(to)
    page.write(file.stem, trip_sections(box, found))
    said = [*lines(found), *([f"wrote {page.name}"] if page.name else [])]
    return Answer(found | {"page": page.name}, lambda: echo("\n".join(said)), page.problem)
