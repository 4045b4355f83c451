"""``micromanip report FILE``: a recorded run as one page of HTML."""

from __future__ import annotations

from pathlib import Path

import click

from .options import StrictCommand, json_option, print_answer
from .prose import say
from .results import require_new_page, write_new_page


@click.command("report", cls=StrictCommand, epilog="Example: micromanip report run.mcap --to run.html")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option(
    "--to", "--out", "to", type=click.Path(path_type=Path), metavar="FILE.html",
    help="New file.  [default: FILE with the ending .html]",
)  # fmt: skip
@json_option
def command(file: Path, to: Path | None, as_json: bool) -> None:
    """A recording of ours as one page: error, spectrum, voltage left, hysteresis loop, step response, timing, marks.

    With --json its figures, too: those of `compare` for one run.
    """
    from micromanip.design.recorded_run import RecordedRun
    from micromanip.design.run_figures import run_figures
    from micromanip.design.run_report import damage, run_report
    from micromanip.recordings import open_telemetry

    from .progress import steps

    to = to or file.with_suffix(".html")
    require_new_page(to)
    telemetry = open_telemetry(file)
    with steps() as bar:
        run = RecordedRun(telemetry, bar.say)
        bar.say("drawing")
        figures = run_figures(run)
        responses = {axis: run.axis[axis].steps.response() for axis in run.axes}
        page = run_report(run, figures, responses)
    if told := damage(run):
        say(f"warning:{told}", err=True)
    write_new_page(to, page)
    document = {"report": str(to), "run": figures.document()}
    document["step_response"] = {axis: found.document() for axis, found in responses.items()}
    print_answer(document, lambda _: say(f"{to}, {len(page) / 1e3:.0f} kB"), as_json)
