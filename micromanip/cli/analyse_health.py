"""``micromanip analyse health``: whether an axis is still the one that was commissioned."""

from __future__ import annotations

import contextlib
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client
from micromanip.errors import CheckFailed, system_error

from .analyse_live import amplitude_option, inject, simulated_cell
from .axes import moved_axis_option
from .echo import echo
from .options import Quantity, emit_json, socket_option, subcommand
from .results import out_option, results_folder

if TYPE_CHECKING:
    from micromanip.design.analyse.health.history import Check
    from micromanip.design.analyse.health.trend import Health
    from micromanip.design.identify.response import Measured
    from micromanip.settings.schema.model import Configuration
    from micromanip.settings.wiring.timing import FeedbackPath


@subcommand(
    "health",
    """micromanip hold && micromanip analyse health --axis all --history out/drift.csv
         micromanip analyse health config/simulated.yaml --axis x --history out/drift.csv --out out/drift""",
)
@click.argument("config", type=click.Path(path_type=Path), metavar="[CONFIG]", required=False)
@moved_axis_option
@click.option(
    "--history", "history", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE",
    help="CSV file to which the check is added, and beside which it is judged.",
)  # fmt: skip
@click.option(
    "--false-alarms", "false_alarms", type=Quantity("Positive", least=10), default=1000.0,
    metavar="CHECKS", help="Checks of an axis between two false alarms of drift.",
)  # fmt: skip
@amplitude_option
@click.option("--seed", type=Quantity("Seed"), default=1, help="Draws phases, and a simulation's noise.")
@out_option("a picture of each axis", metavar="DIR")
@socket_option
def command(
    config: Path | None, only: str, history: Path | None, false_alarms: float, amplitude_um: float, seed: int,
    folder: Path | None, socket_path: Path, as_json: bool,
) -> None:  # fmt: skip
    """Measure gain, first mode, damping and margins of an axis in 10 s, and tell whether they drift.

    At a change of the tool, say: the axis must be TRACKING or HOLDING, and is measured best held, always at the same
    place (`micromanip hold`). A small multisine is played as by `analyse live`. Without a history the figures are only
    compared with the model in the configuration. With CONFIG the simulated cell is measured, in virtual time.

    Exit code 1 where a figure drifts or is outside of what robustness was judged for, and where a margin is surely
    below `accept` or soon will be.
    """
    from micromanip.design.analyse.health.history import append, read_history
    from micromanip.design.analyse.health.trend import judge, of_the_model

    before = [] if history is None else read_history(history)
    found, problems, files = [], [], []
    with contextlib.ExitStack() as places:  # tried before anything moves
        if history is not None:
            places.enter_context(results_folder(history.parent, "--history"))
        if folder is not None:
            places.enter_context(results_folder(folder))
        configuration, checks = _measured(config, only, amplitude_um, seed, socket_path)
        period_s = configuration.loop.period_ns * 1e-9
        for check in checks:
            if history is not None:
                try:
                    append(history, check)
                except OSError as error:
                    raise system_error(error, history) from None
            settings = configuration.axes[check.axis]
            series = [each for each in before if (each.axis, each.tuning) == (check.axis, check.tuning)]
            judged = judge([*series, check], of_the_model(settings, period_s), settings.accept, false_alarms)
            found.append(judged)
            problems += [f"axis {check.axis}: {problem}" for problem in judged.problems]
            if folder is not None:
                files += _draw([*series, check], judged, configuration, folder)
    if as_json:
        emit_json({"axes": [_document(*each) for each in zip(checks, found, strict=True)], "problems": problems,
                    "files": [str(file) for file in files]})  # fmt: skip
    else:
        for judged, check in zip(found, checks, strict=True):
            _print(judged, check)
        for file in files:
            echo(f"wrote {file}")
    if problems:
        raise CheckFailed("; ".join(problems) + "; commission again: micromanip commission CONFIG --axis ...")


def _measured(
    config: Path | None, axis: str, amplitude_um: float, seed: int, socket_path: Path
) -> tuple[Configuration, list[Check]]:
    """What runs, or is simulated with `config`, and the checks of the axes asked for."""
    from micromanip.design.analyse.health.trend import DRAWS, checked, closed_loops
    from micromanip.design.analyse.live_margins import measure_virtually
    from micromanip.settings.excitation_plan import require_axis
    from micromanip.settings.load import validate_document
    from micromanip.settings.text.source import Source
    from micromanip.settings.wiring.timing import FeedbackPath, feedback_path

    checks = []
    with contextlib.ExitStack() as opened:
        if config is None:
            client = opened.enter_context(Client(socket_path))
            configuration = validate_document(Source.parse(Path("(running)"), client.configuration()["text"]))

            def measured(name: str, loop: str) -> tuple[FeedbackPath, Measured]:
                begun, plant = inject(client, name, loop, amplitude_um, seed, DRAWS)
                return FeedbackPath(**begun["path"]), plant
        else:
            prepared = simulated_cell(config, seed)
            configuration = prepared.configuration

            def measured(name: str, loop: str) -> tuple[FeedbackPath, Measured]:
                plant = measure_virtually(prepared, name, loop, amplitude_um, seed, DRAWS)
                return feedback_path(configuration, prepared.wiring, name), plant

        if axis != "all":
            require_axis(configuration, axis)
        for name in configuration.axes if axis == "all" else [axis]:
            found = {loop: measured(name, loop) for loop in closed_loops(configuration.axes[name], name)}
            path = next(reversed(found.values()))[0]
            plants = {loop: plant for loop, (_, plant) in found.items()}
            checks.append(checked(configuration, path, name, plants, datetime.now(UTC)))
    return configuration, checks


def _draw(checks: list[Check], judged: Health, configuration: Configuration, folder: Path) -> list[Path]:
    from micromanip.design.plots.canvas import save
    from micromanip.design.plots.findings import health_plots

    plots = health_plots(checks, judged, configuration.axes[judged.axis].accept)
    title, about = f"Axis {judged.axis}: {judged.checks} checks", f"tuning {checks[-1].tuning}"
    return [save(plots, folder, f"drift_{judged.axis}", title, about=about)]


def _document(check: Check, judged: Health) -> dict[str, Any]:
    watched = [
        {"name": each.name, "latest": each.latest, "before": each.before, "commissioned": each.commissioned,
         "change_percent": 100.0 * each.change, "learning": each.learning,
         "drifts_since": None if each.since is None else each.since.isoformat(timespec="seconds")}
        for each in judged.watched
    ]  # fmt: skip
    return {"axis": check.axis, "time": check.time.isoformat(timespec="seconds"), "tuning": check.tuning,
            "checks": judged.checks, "figures": watched, "stage_gain_dB": check.figures["stage_gain_dB"],
            "stage_phase_deg": check.figures["stage_phase_deg"], "deviations": dict(check.deviations),
            "problems": list(judged.problems)}  # fmt: skip


def _print(judged: Health, check: Check) -> None:
    from micromanip.design.analyse.health.history import LABELS

    from .tables import print_table

    title = f"Axis {judged.axis}: check {judged.checks} under tuning {check.tuning}"
    rows = []
    for each in judged.watched:
        state = "learning" if each.learning else "steady" if each.since is None else "drifts"
        model = "" if each.commissioned != each.commissioned else f"{each.commissioned:.4g}"
        change = f"{100 * each.change:+.1f} %"
        rows.append((LABELS[each.name], f"{each.latest:.4g}", f"{each.before:.4g}", change, model, state))
    print_table(("figure", "now", "before", "change", "in the model", ""), rows, title)
    if check.figures["stage_gain_dB"] == check.figures["stage_gain_dB"]:
        echo(f"outer loop: {_margin(check, 'stage_gain_dB', 'dB', 1)}, {_margin(check, 'stage_phase_deg', 'deg', 0)}")


def _margin(check: Check, name: str, unit: str, digits: int) -> str:
    """A margin and what the check knows it to: two deviations."""
    found, sure = check.figures[name], 2.0 * check.deviations.get(name, float("nan"))
    between = f" ({found - sure:.{digits}f} to {found + sure:.{digits}f})" if isfinite(sure) else ""
    return f"{found:.{digits}f} {unit}{between}"
