"""``micromanip runs``: recordings, trips, commissioning reports and tunings, found again."""

from __future__ import annotations

import difflib
import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import UsageError, system_error

from .options import Quantity, StrictCommand, json_option, print_answer

if TYPE_CHECKING:
    from micromanip.catalogue.describing import Entry

_DATE = re.compile(r"\d{4}-\d{2}(-\d{2}([T ]\d{2}:\d{2}(:\d{2})?)?)?")


@click.command(
    "runs",
    cls=StrictCommand,
    epilog="""\b
Example: micromanip runs --add /srv/recordings
         micromanip runs --kind recording --since 2026-11-01 --sort worst
         micromanip runs --fault X-201 --page runs.html""",
)
@click.option(
    "--add",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Look through FOLDER, too, from now on.",
)
@click.option("--drop", type=click.Path(path_type=Path), help="Look through it no more.")
@click.option("--kind", type=click.Choice(["recording", "trip", "report", "tuning"]), help="These only.")
@click.option("--since", metavar="DATE", help="Begun then or later: 2026-11-01, or to the second; UTC.")
@click.option("--until", metavar="DATE", help="Begun then or before; a day counts whole.")
@click.option("--fault", metavar="CODE", help="With this fault, as X-201.")
@click.option("--configuration", metavar="HASH", help="Of this configuration or tuning, by a part of its hash.")
@click.option("--text", metavar="WORDS", help="With these words in path, marks, or what is said of it.")
@click.option("--above-um", type=Quantity("DistanceOrZero"), help="With an axis whose path error is larger (rms).")
@click.option(
    "--sort", type=click.Choice(["newest", "oldest", "worst", "longest"]), default="newest", show_default=True
)
@click.option("--most", type=Quantity("Count"), default=50, show_default=True, help="So many at most.")
@click.option("--page", type=click.Path(path_type=Path), help="New file: what was found as one page of HTML.")
@json_option
def command(add: Path | None, drop: Path | None, page: Path | None, as_json: bool, **wanted: Any) -> None:
    """What was recorded, tripped, reported and tuned; the catalogue is brought up to date first.

    Looked through are the trips and recordings of a controller that was started here, and each FOLDER that was added.
    The catalogue keeps nothing but what is in the files: it may be removed, and is made again.
    """
    from micromanip.catalogue.store import FILE, Catalogue, Query
    from micromanip.faults import BY_NAME
    from micromanip.host.state_directory import state_directory

    for option in ("since", "until"):
        if wanted[option] is not None and not _DATE.fullmatch(wanted[option]):
            raise UsageError(
                f"--{option} {wanted[option]}: expected a date, 2026-11-01, or a time, 2026-11-01T07:30:00"
            )
    codes = {kind.code for kind in BY_NAME.values()}
    if wanted["fault"] is not None and wanted["fault"] not in codes:
        near = difflib.get_close_matches(wanted["fault"], codes, 1)
        raise UsageError(f"--fault {wanted['fault']}: no such code" + (f"; did you mean {near[0]}?" if near else ""))
    if page is not None and page.exists():
        raise UsageError(f"{page} is there already: nothing is replaced; name another file with --page")
    own = state_directory()
    with Catalogue(own / FILE) as catalogue:
        if drop is not None and not catalogue.drop(drop):
            raise UsageError(
                f"{drop} is not looked through; these are: {', '.join(map(str, catalogue.folders())) or 'none'}"
            )
        if add is not None:
            catalogue.add(add)
        folders = [own, *catalogue.folders()]
        catalogue.refresh(folders, lambda path: click.echo(f"reading {path}", err=True))
        found = catalogue.find(Query(**wanted))
        document = {"folders": [str(folder) for folder in folders], "entries": catalogue.count(),
                    "found": [{**asdict(entry), "path": str(entry.path)} for entry in found]}  # fmt: skip
    if page is not None:
        _write_page(page, found)
    print_answer(document, lambda _: _show(found, document), as_json)


def _row(entry: Entry) -> tuple[str, ...]:
    worst = max(entry.rms_um.values(), default=None)
    return (
        entry.began[:19],
        entry.kind,
        str(entry.path),
        "" if entry.seconds is None else f"{entry.seconds:.1f}",
        "" if worst is None else f"{worst:.3f}",
        " ".join(entry.faults),
        "; ".join(text for text in (entry.about, entry.problem) if text),
    )


_HEAD = ("begun", "kind", "file", "s", "worst rms, um", "faults", "about")


def _show(found: list[Entry], document: dict[str, Any]) -> None:
    from .tables import Figures, out_console

    console = out_console()
    if found:
        table = Figures(*_HEAD)
        for entry in found:
            table.add_row(*_plain(_row(entry)))
        console.print(table)
    console.print(f"{len(found)} of {document['entries']} in {', '.join(_plain(document['folders']))}")


def _plain(texts: Any) -> list[str]:
    from rich.markup import escape

    return [escape(text) for text in texts]


def _write_page(place: Path, found: list[Entry]) -> None:
    from micromanip.design.page import page, table

    try:
        place.write_text(page("Runs", [table(_HEAD, [_row(entry) for entry in found], words=True)]), encoding="utf-8")
    except OSError as problem:
        raise system_error(problem, place) from problem
