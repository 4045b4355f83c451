"""``micromanip recording report`` and ``compare``: a recorded run as a page, two side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .echo import echo
from .options import Answer, subcommand
from .results import Page, require_new_page

if TYPE_CHECKING:
    from micromanip.design.run.statistics import RecordedRun


@subcommand("report", "micromanip recording report run.mcap --to run.html")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option(
    "--to", type=click.Path(path_type=Path), metavar="FILE.html",
    help="New file.  [default: FILE with the ending .html]",
)  # fmt: skip
def report(file: Path, to: Path | None) -> Answer:
    """A recording of ours as one page: error, spectrum, voltage left, hysteresis loop, timing, marks.

    With --json its figures, too: those of `compare` for one run.
    """
    from micromanip.design.run.comparison import run_figures
    from micromanip.design.run.report import run_report
    from micromanip.design.run.statistics import RecordedRun
    from micromanip.recordings import open_telemetry

    from .progress import steps

    to = to or file.with_suffix(".html")
    require_new_page(to)
    telemetry = open_telemetry(file)
    with steps() as bar:
        run = RecordedRun(telemetry, bar.say)
        bar.say("drawing")
        figures = run_figures(run)
        page = Page(to)
        page.write(f"Run {file.name}", run_report(run, figures))
    _warn(run)
    return Answer({"page": page.name, "run": figures.document()}, page.echo, page.problem)


@subcommand("compare", "micromanip recording compare monday.mcap tuesday.mcap --to week.html")
@click.argument("first", type=click.Path(path_type=Path), metavar="A")
@click.argument("second", type=click.Path(path_type=Path), metavar="B")
@click.option(
    "--to", type=click.Path(path_type=Path), metavar="FILE.html",
    help="New file: both as one page of HTML.",
)  # fmt: skip
def compare(first: Path, second: Path, to: Path | None) -> Answer:
    """Two recordings of ours: error, its spectrum, headroom, timing, and what differs in their configurations.

    Whether B's error is lower or higher is judged with 95 % confidence, by as many independent pieces as the runs have.
    --to draws both side by side, judges every quantity, and says what each parameter that differs means.
    """
    from micromanip.design.run.comparison import compared, configuration_changes, ratio, run_figures
    from micromanip.design.run.report import comparison
    from micromanip.design.run.statistics import BANDS_Hz, RecordedRun
    from micromanip.recordings import open_telemetry

    from .progress import steps

    if to is not None:
        require_new_page(to)
    both = [open_telemetry(file) for file in (first, second)]
    with steps() as bar:
        runs = [RecordedRun(telemetry, bar.say) for telemetry in both]
    for run in runs:
        _warn(run)
    a, b = figures = [run_figures(run) for run in runs]
    changes = configuration_changes(*(run.telemetry.configuration for run in runs))
    found_differences = compared(runs, figures)
    axes = {}
    for axis in (name for name in a.axes if name in b.axes):
        squares = [run.squares[axis].whole for run in figures]
        found = ratio(*squares)
        axes[axis] = {"ratio": found.value, "ratio_95": [found.low, found.high], "verdict": found.verdict}
        axes[axis] |= {"independent": [each.batches for each in squares]}
    document: dict[str, Any] = {
        "a": a.document(),
        "b": b.document(),
        "bands_Hz": BANDS_Hz,
        "axes": axes,
        "configuration": changes,
        "quantities": [each.document() for each in found_differences],
    }
    page = Page(to)
    page.write(f"A {first.name} and B {second.name}", comparison(runs, figures, found_differences, changes))
    document["page"] = page.name
    return Answer(document, lambda: _show_comparison(document, page), page.problem)


def _show_comparison(document: dict[str, Any], page: Page) -> None:
    from .tables import print_table

    a, b = document["a"], document["b"]
    for name, run in (("A", a), ("B", b)):
        echo(f"{name} {run['file']}, {run['tracking_s']:.1f} s of tracking")
    errors, spectra, timing = [], [], []
    for axis, found in document["axes"].items():
        one, two = a["axes"][axis], b["axes"][axis]
        low, high = found["ratio_95"]
        errors.append((
            axis, f"{one['rms_um']:.4f}", f"{two['rms_um']:.4f}", f"{found['ratio']:.3f}", f"{low:.3f} to {high:.3f}",
            found["verdict"], f"{one['max_um']:.2f}", f"{two['max_um']:.2f}",
        ))  # fmt: skip
        for name, figures in (("A", one), ("B", two)):
            headroom = "-" if figures["headroom_V"] is None else f"{figures['headroom_V']:.1f}"
            in_bands = (f"{value:.4f}" for value in figures["bands_um"])
            spectra.append((axis, name, *in_bands, f"{figures['peak_Hz']:.1f}", headroom))
    for name, run in (("A", a), ("B", b)):
        codes = ", ".join(run["faults"]) or "-"
        for kind in ("lateness", "compute"):
            values = (f"{value / 1e3:.2f}" for value in run[f"{kind}_ns"])
            timing.append((f"{name} {kind}", *values, str(run["skipped"]), str(run["lost"]), codes))
    print_table(("axis", "A rms", "B rms", "B to A", "95 %", "B is", "A max", "B max"), errors, "Path error, um")
    bands = [f"{low:g}-{high:g} Hz" for low, high in document["bands_Hz"]]
    print_table(("axis", "", *bands, "most at, Hz", "headroom, V"), spectra, "Path error by band, um rms")
    print_table(("", "p50", "p99.9", "max", "skipped", "lost", "faults"), timing, "Timing, us")
    for change in document["configuration"]:
        echo(f"{change['key']}: {change['old']} -> {change['new']}")
    if not document["configuration"]:
        echo("the configurations are the same")
    page.echo()


def _warn(run: RecordedRun) -> None:
    from micromanip.design.run.report import damage

    if told := damage(run):
        echo(f"warning: {run.telemetry.file}:{told}", err=True)
