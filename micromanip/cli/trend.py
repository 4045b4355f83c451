"""``micromanip trend``: figures of each second and minute of months, as a table, a picture or a file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import CheckFailed, UsageError, system_error

from .options import StrictCommand, json_option, print_answer
from .results import require_new

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console

    from micromanip.recordings.trend import Trend

_DATE = re.compile(r"\d{4}-\d{2}-\d{2}([T ]\d{2}(:\d{2}(:\d{2})?)?)?")
_GAPS_SHOWN = 10


@click.command(
    "trend",
    cls=StrictCommand,
    epilog="""\b
Example: micromanip trend /var/lib/micromanip/trend --since 2026-11-01
         micromanip trend out/trend --field error_um_x_rms --field headroom_V --to error.svg""",
)
@click.argument("place", type=click.Path(path_type=Path), metavar="FOLDER|FILE")
@click.option("--since", metavar="DATE", help="Rows from then on: 2026-11-01, or 2026-11-01T07:30; UTC.")
@click.option("--until", metavar="DATE", help="Rows before that time.")
@click.option(
    "--field", "fields", multiple=True, metavar="NAME", help="A column, or what several begin with; may be repeated."
)
@click.option("--every", type=click.Choice(["second", "minute"]), help="Rows of a folder.  [default: minute]")
@click.option(
    "--to",
    "--out",
    "to",
    type=click.Path(path_type=Path),
    help="New file: the rows as .csv, or a picture, .svg or .png.",
)
@json_option
def command(
    place: Path,
    since: str | None,
    until: str | None,
    fields: tuple[str, ...],
    every: str | None,
    to: Path | None,
    as_json: bool,
) -> None:
    """What a controller with `trend` in its configuration has kept: one line per day, or per hour of up to two days.

    Below, how each figure went: a character for each forty-eighth of the time, as high as the figure between least and
    greatest.

    Time in which no controller ran is told as a gap, and left out of the lines of a picture.
    """
    from micromanip.design.trend import summarised, told, usual_fields
    from micromanip.recordings.trend import read_trend

    if to is not None and to.suffix.lower() not in (".csv", ".svg", ".png"):
        raise UsageError(f"--to {to}: a trend is written as .csv, or drawn as .svg or .png: name it so")
    if to is not None:
        require_new(to, "--to")
    if not place.exists():
        raise CheckFailed(f"{place}: no such file or folder")
    trend = read_trend(place, every, _time("since", since), _time("until", until), fields)
    chosen = list(fields) or usual_fields(trend)
    if to is not None:
        _write(trend, chosen if fields or to.suffix.lower() != ".csv" else list(trend.columns), to)
    gaps = [
        {"from": str(begin), "to": str(end), "seconds": int((end - begin).astype(int))} for begin, end in trend.gaps()
    ]
    document = {
        "every": trend.every,
        "rows": len(trend.time),
        **told(trend, chosen),
        "periods": summarised(trend, chosen),
        "gaps": gaps,
        "file": None if to is None else str(to),
    }
    print_answer(document, _show, as_json)


def _time(option: str, text: str | None) -> np.datetime64 | None:
    import numpy as np

    if text is None:
        return None
    try:
        if _DATE.fullmatch(text):
            return np.datetime64(text.replace(" ", "T"), "s")
    except ValueError:
        pass
    raise UsageError(f"--{option} {text}: expected a date, 2026-11-01, or a time, 2026-11-01T07:30:00")


def _write(trend: Trend, fields: list[str], to: Path) -> None:
    from micromanip.design.trend import draw, write_csv

    try:
        (write_csv if to.suffix.lower() == ".csv" else draw)(trend, fields, to)
    except OSError as problem:
        to.unlink(missing_ok=True)
        raise system_error(problem, to) from problem


def _show(document: dict[str, Any]) -> None:
    from .tables import Figures, out_console

    console = out_console()
    periods, gaps = document["periods"], document["gaps"]
    table = Figures(*periods[0])
    for period in periods:
        table.add_row(*(_cell(value) for value in period.values()))
    console.print(table)
    show_courses(console, document)
    for gap in gaps[:_GAPS_SHOWN]:
        console.print(f"nothing ran from {gap['from']} to {gap['to']} ({_length(gap['seconds'])})")
    if len(gaps) > _GAPS_SHOWN:
        console.print(f"and {len(gaps) - _GAPS_SHOWN} gaps more; --json has them all")
    if document["file"] is not None:
        console.print(f"{document['rows']} rows, one a {document['every']}, to {document['file']}")


def show_courses(console: Console, told: dict[str, Any]) -> None:
    """A line for each of `courses`, which go over the time `from` .. `to`."""
    from .tables import Figures

    table = Figures(title=f"{told['from']} to {told['to']}")
    for heading in ("column", "least", "greatest", "last", "over the time"):
        table.add_column(heading, justify="right" if heading in ("least", "greatest", "last") else "left")
    for course in told["courses"]:
        figures = (_cell(course[name]) for name in ("least", "greatest", "last"))
        table.add_row(course["field"], *figures, course["drawn"])
    console.print(table)


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(value)
    return "" if value is None else value if isinstance(value, str) else f"{value:.4g}"


def _length(seconds: int) -> str:
    if seconds < 120:
        return f"{seconds} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
