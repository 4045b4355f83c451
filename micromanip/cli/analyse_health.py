"""``micromanip analyse health``: whether an axis is still the one that was commissioned."""

from __future__ import annotations

from math import isfinite, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client
from micromanip.errors import CheckFailed

from .analyse_live import amplitude_option, inject
from .axes import moved_axis_option
from .echo import echo
from .options import Quantity, emit_json, socket_option, subcommand

if TYPE_CHECKING:
    from micromanip.design.analyse.health import Check


@subcommand("health", "micromanip hold && micromanip analyse health --axis all")
@moved_axis_option
@amplitude_option
@click.option("--seed", type=Quantity("Seed"), default=1, help="Draws phases.")
@socket_option
def command(only: str, amplitude_um: float, seed: int, socket_path: Path, as_json: bool) -> None:
    """Measure gain, first mode, damping and margins of an axis in 20 s, beside those that were commissioned.

    At a change of the tool, say: the axis must be TRACKING or HOLDING, and is measured best held, always at the same
    place (`micromanip hold`). A small multisine is played as by `analyse live`.

    Exit code 1 where a figure is outside of what robustness was judged for, and where a margin is surely below
    `accept`.
    """
    checks = _measured(only, amplitude_um, seed, socket_path)
    problems = [f"axis {check.axis}: {problem}" for check in checks for problem in check.problems]
    if as_json:
        emit_json({"axes": [_document(check) for check in checks], "problems": problems})
    else:
        for check in checks:
            _print(check)
    if problems:
        raise CheckFailed("; ".join(problems) + "; commission again: micromanip commission CONFIG --axis ...")


def _measured(axis: str, amplitude_um: float, seed: int, socket_path: Path) -> list[Check]:
    """The axes asked for, of what runs."""
    from micromanip.design.analyse.health import DRAWS, checked, closed_loops
    from micromanip.settings.excitation_plan import require_axis
    from micromanip.settings.load import validate_document
    from micromanip.settings.text.source import Source
    from micromanip.settings.wiring.timing import FeedbackPath

    checks = []
    with Client(socket_path) as client:
        configuration = validate_document(Source.parse(Path("(running)"), client.configuration()["text"]))
        if axis != "all":
            require_axis(configuration, axis)
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


def _print(check: Check) -> None:
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
