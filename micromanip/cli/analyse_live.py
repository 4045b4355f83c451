"""``micromanip analyse live`` and ``health``: margins of a running loop, and whether it has changed."""

from __future__ import annotations

from math import isfinite, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client
from micromanip.errors import CheckFailed, require_axis

from .echo import echo
from .options import Answer, Quantity, moved_axis_option, one_axis_option, socket_option, subcommand
from .results import out_option, page_in

if TYPE_CHECKING:
    from micromanip.design.analyse.health import Check
    from micromanip.design.analyse.live_margins import Running
    from micromanip.design.identify.response import Measured
    from micromanip.replies import Injected

amplitude_option = click.option(
    "--amplitude-um", "amplitude_um", type=Quantity("Distance", least=0.001, most=10.0), default=0.3,
    metavar="UM", help="Rms of the multisine on the actuator's set-point.",
)  # fmt: skip


@subcommand("live", "micromanip analyse live --axis x --loop stage")
@one_axis_option
@click.option("--loop", type=click.Choice(["strain", "stage"]), default="strain", help="Its loop.")
@amplitude_option
@click.option("--seed", type=Quantity("Seed"), default=1, help="Draws its phases.")
@out_option("the page live_AXIS_LOOP.html")
@socket_option
def live(
    axis: str, loop: Any, amplitude_um: float, seed: int, folder: Path | None, socket_path: Path,
) -> Answer:  # fmt: skip
    """Measure gain and phase margin of a loop, and Ms, while everything runs.

    A small multisine is added to the actuator's set-point, twice for 5 s, within the limits; it begins and ends softly,
    and is ended at once by a disarm, a fault, or the end of this command. The axis must be TRACKING or HOLDING; held
    (`micromanip hold`) it is measured best.

    Exit code 1 where measured and predicted do not agree, the confidence leaves it open, or margins are below `accept`.
    """
    from micromanip.design.analyse.live_margins import DRAWS, document, judge_running
    from micromanip.settings.load import validate_document
    from micromanip.settings.text.source import Source
    from micromanip.settings.wiring.timing import FeedbackPath

    where = f"the controller on {socket_path}"
    with Client(socket_path) as client:
        begun, plant = inject(client, axis, loop, amplitude_um, seed, DRAWS)
    running = validate_document(Source.of(begun["configuration"], Path("(running)")))
    found = judge_running(running, FeedbackPath(**begun["path"]), axis, loop, plant)
    with page_in(folder, f"live_{axis}_{loop}.html") as page:
        if folder is not None:
            from micromanip.design.plots.findings import running_plots
            from micromanip.design.report.model import Section

            page.write(f"Axis {axis}, {found.loop.name}", [Section("Measured", where, {}, running_plots(found))])

    def show() -> None:
        _print_loop(found, where)
        page.echo()

    failed = CheckFailed(f"axis {axis}, {found.loop.name}: {found.problem}") if found.problem is not None else None
    return Answer(document(found, loop) | {"page": page.name}, show, failed or page.problem)


def inject(
    client: Client, axis: str, loop: str, amplitude_um: float, seed: int, draws: int
) -> tuple[Injected, Measured]:
    """What was injected last, and the plant's response to `draws` multisines with phases from `seed` on.

    Raises CheckFailed where the controller refuses it, or it was ended early.
    """
    from micromanip.design.analyse.live_margins import plant_of

    from .progress import steps

    responses = []
    with steps() as bar:
        for draw in range(draws):
            bar.say(f"axis {axis}, {loop} loop: multisine {draw + 1} of {draws}")
            begun, response = client.analyse_live(axis, loop, amplitude_um, seed + draw)
            responses.append(response)
    return begun, plant_of(responses)


def _print_loop(found: Running, where: str) -> None:
    from micromanip.design.analyse.live_margins import figures

    from .tables import print_table

    columns = ("slope", "", "Ms", "at, Hz", "gain margin, dB", "phase margin, deg")
    rows = [
        (f"{slope:.2f}", name, *(f"{value:.2f}" for value in figures(margins[k]).values()))
        for k, slope in enumerate(found.slopes)
        for name, margins in (("measured", found.measured), ("predicted", found.predicted))
        if margins is not None
    ]
    print_table(columns, rows, f"Axis {found.axis}, {found.loop.name}")
    low, high = found.loop.frequency_Hz[[0, -1]]
    least, most = found.confidence
    echo(f"Ms {least:.2f} to {most:.2f} by its confidence, {low:.0f} to {high:.0f} Hz; {where}")
    if found.predicted is None:
        echo("no prediction: the configuration holds no model of the actuator; `commission` finds one")
    elif found.agrees:
        echo("measured and predicted agree")


@subcommand("health", "micromanip hold && micromanip analyse health --axis all")
@moved_axis_option
@amplitude_option
@click.option("--seed", type=Quantity("Seed"), default=1, help="Draws phases.")
@socket_option
def health(only: str, amplitude_um: float, seed: int, socket_path: Path) -> Answer:
    """Measure gain, first mode, damping and margins of an axis in 20 s, beside those that were commissioned.

    At a change of the tool, say: the axis must be TRACKING or HOLDING, and is measured best held, always at the same
    place (`micromanip hold`). A small multisine is played as by `analyse live`.

    Exit code 1 where a figure is outside of what robustness was judged for, and where a margin is surely below
    `accept`.
    """
    checks = _measured(only, amplitude_um, seed, socket_path)
    problems = [f"axis {check.axis}: {problem}" for check in checks for problem in check.problems]
    failed = CheckFailed("; ".join(problems) + "; commission again: micromanip commission CONFIG --axis ...")
    document = {"axes": [_document(check) for check in checks], "problems": problems}
    return Answer(document, lambda: list(map(_print_check, checks)), failed if problems else None)


def _measured(axis: str, amplitude_um: float, seed: int, socket_path: Path) -> list[Check]:
    """The axes asked for, of what runs."""
    from micromanip.design.analyse.health import DRAWS, checked, closed_loops
    from micromanip.settings.load import validate_document
    from micromanip.settings.text.source import Source
    from micromanip.settings.wiring.timing import FeedbackPath

    checks = []
    with Client(socket_path) as client:
        configuration = validate_document(Source.parse(Path("(running)"), client.configuration()["text"]))
        if axis != "all":
            require_axis(axis, configuration.axes)
        for name in configuration.axes if axis == "all" else [axis]:
            loops = closed_loops(configuration.axes[name], name)
            found = {loop: inject(client, name, loop, amplitude_um, seed, DRAWS) for loop in loops}
            path = FeedbackPath(**next(reversed(found.values()))[0]["path"])
            checks.append(checked(configuration, path, name, {loop: plant for loop, (_, plant) in found.items()}))
    return checks


def _document(check: Check) -> dict[str, Any]:
    from micromanip.design.analyse.health import LABELS

    figures = [
        {"name": name, "latest": getattr(check.figures, name), "commissioned": getattr(check.tuned, name),
         "change_percent": 100.0 * check.change(name)}
        for name in LABELS if not isnan(getattr(check.figures, name))
    ]  # fmt: skip
    return {"axis": check.axis, "figures": figures, **check.margins, "deviations": dict(check.deviations),
            "problems": list(check.problems)}  # fmt: skip


def _print_check(check: Check) -> None:
    from micromanip.design.analyse.health import LABELS, MARGINS

    from .tables import print_table

    rows = []
    for name, label in LABELS.items():
        found, tuned = getattr(check.figures, name), getattr(check.tuned, name)
        if not isnan(found):
            model, change = ("", "") if isnan(tuned) else (f"{tuned:.4g}", f"{100 * check.change(name):+.1f} %")
            rows.append((label, f"{found:.4g}", model, change))
    print_table(("figure", "now", "in the model", "change"), rows, f"Axis {check.axis}")
    margins = [_margin(check, name, unit) for name, unit in MARGINS.items() if name in check.margins]
    if margins:
        echo(f"outer loop: {', '.join(margins)}")


def _margin(check: Check, name: str, unit: str) -> str:
    """A margin and what the check knows it to: two deviations."""
    found, sure = check.margins[name], 2.0 * check.deviations[name]
    between = f" ({found - sure:.3g} to {found + sure:.3g})" if isfinite(sure) else ""
    return f"{found:.3g} {unit}{between}"
