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
from .prose import say
from .results import require_new

if TYPE_CHECKING:
    from micromanip.catalogue.describing import Entry
    from micromanip.recordings.trend import Trend

_MOST_DAYS = 1_000_000
_DATE = re.compile(r"\d{4}-\d{2}(-\d{2}([T ]\d{2}:\d{2}(:\d{2})?)?)?")


@click.command(
    "runs",
    cls=StrictCommand,
    epilog="""\b
Example: micromanip runs --add /srv/recordings
         micromanip runs --kind recording --since 2026-11-01 --sort worst
         micromanip runs --fault X-201 --page runs.html
         micromanip runs --trend error_um --since 2026-10""",
)
@click.option(
    "--add",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Look through FOLDER, too, from now on.",
)
@click.option("--drop", type=click.Path(path_type=Path), help="Look through it no more.")
@click.option("--kind", type=click.Choice(["recording", "trip", "trend", "report", "tuning"]), help="These only.")
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
@click.option("--trend", "field", metavar="NAME", help="How a figure went over the days found: error_um, headroom_V.")
@click.option("--page", type=click.Path(path_type=Path), help="New file: what was found as one page of HTML.")
@json_option
def command(
    add: Path | None, drop: Path | None, field: str | None, page: Path | None, as_json: bool, **wanted: Any
) -> None:
    """What was recorded, tripped, reported and tuned, and days of a trend; the catalogue is brought up to date first.

    Looked through are the trips and recordings of a controller that was started here, and each FOLDER that was added.
    The catalogue keeps nothing but what is in the files: it may be removed, and is made again.
    """
    from micromanip.catalogue import FILE
    from micromanip.catalogue.store import Catalogue, Query
    from micromanip.design.trend import told
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
    if page is not None:
        require_new(page, "--page")
    own = state_directory()
    with Catalogue(own / FILE) as catalogue:
        if drop is not None and not catalogue.drop(drop):
            raise UsageError(
                f"{drop} is not looked through; these are: {', '.join(map(str, catalogue.folders())) or 'none'}"
            )
        if add is not None:
            catalogue.add(add)
        folders = [own, *catalogue.folders()]
        catalogue.refresh(folders, lambda path: say(f"reading {path}", err=True))
        found = catalogue.find(Query(**wanted))
        document = {"folders": [str(folder) for folder in folders], "entries": catalogue.count(),
                    "found": [{**asdict(entry), "path": str(entry.path)} for entry in found]}  # fmt: skip
        days = [] if field is None else catalogue.find(Query(kind="trend", most=_MOST_DAYS))
    trends = [] if field is None else _trends(days, field, wanted["since"], wanted["until"])
    document["trends"] = [{"folder": str(folder), **told(trend, [field or ""])} for folder, trend in trends]
    if page is not None:
        _write_page(page, found, [(folder, trend, field or "") for folder, trend in trends])
    print_answer(document, lambda _: _show(found, document), as_json)


def _trends(days: list[Entry], field: str, since: str | None, until: str | None) -> list[tuple[Path, Trend]]:
    """The minutes of each folder with such days, of the time that is asked for."""
    import numpy as np

    from micromanip.errors import CheckFailed
    from micromanip.recordings.trend import MINUTE, read_trend

    if not days:
        raise CheckFailed("no trend was found; `trend: {}` in the configuration keeps one")
    begin = None if since is None else np.datetime64(since.replace(" ", "T")).astype("datetime64[s]")
    end = None if until is None else (np.datetime64(until.replace(" ", "T")) + 1).astype("datetime64[s]")
    found, problems = [], []
    for folder in sorted({day.path.parent for day in days}):
        try:
            found.append((folder, read_trend(folder, MINUTE, begin, end, [field])))
        except CheckFailed as problem:
            problems.append(problem)
    if not found:
        raise problems[0]
    return found


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
    from .trend import show_courses

    console = out_console()
    if found:
        table = Figures(*_HEAD)
        for entry in found:
            table.add_row(*_plain(_row(entry)))
        console.print(table)
    for each in document["trends"]:
        console.print(each["folder"], markup=False, highlight=False)
        show_courses(console, each)
    console.print(f"{len(found)} of {document['entries']} in {', '.join(_plain(document['folders']))}")


def _plain(texts: Any) -> list[str]:
    from rich.markup import escape

    return [escape(text) for text in texts]


def _write_page(place: Path, found: list[Entry], trends: list[tuple[Path, Trend, str]]) -> None:
    from html import escape

    from micromanip.design.page import legible, page, section, table
    from micromanip.design.trend import drawn

    parts = [table(_HEAD, [_row(entry) for entry in found], words=True)]
    for folder, trend, field in trends:
        about = f"{escape(str(folder))}, one value per minute."
        with legible():
            figure = drawn(trend, [field])
        parts.append(section(f"Trend of {escape(field)}", about, figure))
    try:
        place.write_text(page("Runs", parts), encoding="utf-8")
    except OSError as problem:
        raise system_error(problem, place) from problem
