"""``micromanip analyse live``: margins of a loop, measured while it runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client
from micromanip.errors import CheckFailed, UsageError

from .axes import one_axis_option
from .echo import echo
from .options import Quantity, emit_json, socket_option, subcommand
from .results import out_option, results_folder

if TYPE_CHECKING:
    from micromanip.design.analyse.live_margins import Running
    from micromanip.design.identify.response import Measured
    from micromanip.replies import Injected
    from micromanip.settings.check import Prepared

amplitude_option = click.option(
    "--amplitude-um", "amplitude_um", type=Quantity("Distance", least=0.001, most=10.0), default=0.3,
    metavar="UM", help="Rms of the multisine on the actuator's set-point.",
)  # fmt: skip


@subcommand(
    "live",
    "micromanip analyse live --axis x     or, in virtual time: micromanip analyse live "
    "config/simulated.yaml --axis x --loop stage",
)
@click.argument("config", type=click.Path(path_type=Path), metavar="[CONFIG]", required=False)
@one_axis_option
@click.option("--loop", type=click.Choice(["strain", "stage"]), default="strain", help="Its loop.")
@amplitude_option
@click.option("--seed", type=Quantity("Seed"), default=1, help="Draws its phases.")
@out_option("a picture", metavar="DIR")
@socket_option
def command(
    config: Path | None, axis: str, loop: Any, amplitude_um: float, seed: int, folder: Path | None, socket_path: Path,
    as_json: bool,
) -> None:  # fmt: skip
    """Measure gain and phase margin of a loop, and Ms, while everything runs.

    A small multisine is added to the actuator's set-point, twice for 5 s, within the limits; it begins and ends softly,
    and is ended at once by a disarm, a fault, or the end of this command. The axis must be TRACKING or HOLDING; held
    (`micromanip hold`) it is measured best. With CONFIG the simulated cell is measured, in virtual time.

    Exit code 1 where measured and predicted do not agree, the confidence leaves it open, or margins are below `accept`.
    """
    from micromanip.design.analyse.live_margins import document, judge_running, measure_virtually, simulated_actuator
    from micromanip.settings.excitation_plan import require_axis

    if config is not None:
        prepared = simulated_cell(config)
        require_axis(prepared.configuration, axis)
        plant = measure_virtually(prepared, axis, loop, amplitude_um, seed)
        path, where = _path(prepared, axis), f"{config}, in virtual time"
    else:
        prepared, path, plant = _live(axis, loop, amplitude_um, seed, socket_path)
        where = f"the controller on {socket_path}"
    modelled = loop == "strain" and prepared.wiring.virtual
    actuator = simulated_actuator(prepared, axis) if modelled else None
    found = judge_running(prepared.configuration, path, axis, loop, plant, actuator)
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


def simulated_cell(config: Path, seed: int | None = None) -> Prepared:
    """The cell of `config`, with a `seed` of its noise; UsageError where it is not simulated."""
    from micromanip.settings.check import prepare

    prepared = prepare(config, seed)
    if not prepared.wiring.virtual:
        raise UsageError(f"{config} is not a simulated cell: start it, and leave CONFIG out")
    return prepared


def _path(prepared: Prepared, axis: str) -> Any:
    from micromanip.settings.wiring.timing import feedback_path

    return feedback_path(prepared.configuration, prepared.wiring, axis)


def _live(axis: str, loop: str, amplitude_um: float, seed: int, socket_path: Path) -> tuple[Prepared, Any, Any]:
    """What runs, and the response of its plant."""
    from micromanip.design.analyse.live_margins import DRAWS
    from micromanip.settings.check import prepared
    from micromanip.settings.text.source import Source
    from micromanip.settings.wiring.timing import FeedbackPath

    with Client(socket_path) as client:
        begun, plant = inject(client, axis, loop, amplitude_um, seed, DRAWS)
    running = prepared(Source.of(begun["configuration"], Path("(running)")))
    return running, FeedbackPath(**begun["path"]), plant


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
