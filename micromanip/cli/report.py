"""``micromanip report FILE``: a recorded run as one page of HTML."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.errors import UsageError, system_error

from .options import StrictCommand, json_option, print_answer


@click.command("report", cls=StrictCommand, epilog="Example: micromanip report run.mcap --to run.html")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option("--to", type=click.Path(path_type=Path), help="New file.  [default: FILE with the ending .html]")
@json_option
def command(file: Path, to: Path | None, as_json: bool) -> None:
    """A recording of ours as one page: error, spectrum, voltage left, hysteresis loop, timing, marks, configuration.

    With --json its figures, too: those of `compare` for one run.
    """
    from micromanip.design.run_figures import run_figures
    from micromanip.design.run_report import run_report
    from micromanip.recordings import open_telemetry

    to = to or file.with_suffix(".html")
    telemetry = open_telemetry(file)
    figures = run_figures(telemetry)
    page = run_report(telemetry, figures)
    try:
        with to.open("x", encoding="utf-8") as written:
            written.write(page)
    except FileExistsError:
        raise UsageError(f"{to} is there already: nothing is replaced; name another file with --to") from None
    except OSError as problem:
        raise system_error(problem, to) from problem
    document = {"report": str(to), "run": figures.document()}
    print_answer(document, lambda _: click.echo(f"{to}, {len(page) / 1e3:.0f} kB"), as_json)
