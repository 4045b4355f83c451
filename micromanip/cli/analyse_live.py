"""``micromanip analyse live``: margins of a loop, measured while it runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client
from micromanip.errors import CheckFailed

from .axes import one_axis_option
from .echo import echo
from .options import Quantity, emit_json, socket_option, subcommand
from .results import out_option, results_folder

if TYPE_CHECKING:
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
@out_option("a picture", metavar="DIR")
@socket_option
def command(
    axis: str, loop: Any, amplitude_um: float, seed: int, folder: Path | None, socket_path: Path, as_json: bool,
) -> None:  # fmt: skip
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
    files = []
    if folder is not None:
        from micromanip.design.plots.canvas import save
        from micromanip.design.plots.findings import running_plots

        with results_folder(folder):
            files.append(save(running_plots(found), folder, f"sensitivity_{axis}_{loop}", about=where))
    if as_json:
        emit_json(document(found, loop) | {"files": [str(file) for file in files]})
    else:
        _print(found, where, files)
    if found.problem is not None:
        raise CheckFailed(f"axis {axis}, {found.loop.name}: {found.problem}")


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


def _print(found: Running, where: str, files: list[Path]) -> None:
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
    for file in files:
        echo(f"wrote {file}")
