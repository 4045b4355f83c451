"""Where a candidate tuning stands, as several commands print it."""

from __future__ import annotations

import click
from rich.console import Console
from rich.table import Table

from micromanip.replies import Shadow

from .parameters import echo_changes


def echo_shadow(shadow: Shadow) -> None:
    """Standing, what it changes, and its figures so far."""
    click.echo(standing_line(shadow))
    echo_changes(shadow["changed"])
    if shadow["reason"]:
        click.echo(shadow["reason"])
    table = _comparison(shadow) if shadow["comparison"] else _trial(shadow) if shadow["trial"] else None
    if table is not None:
        Console(highlight=False).print(table)


def standing_line(shadow: Shadow) -> str:
    """One line: the candidate's version, where it stands, and how much of its trial is over."""
    if shadow["version"] is None:
        return "there is no candidate"
    line = f"candidate, parameter version {shadow['version']}: {shadow['standing']}"
    if shadow["passed_s"] is not None and shadow["trial_s"] is not None:
        passed_s = min(shadow["passed_s"], shadow["trial_s"])
        line += f", {passed_s:.1f} of {shadow['trial_s']:g} s"
    return line


def _comparison(shadow: Shadow) -> Table:
    table = Table("axis", title="rms: active -> candidate")
    table.add_column("innovation, um")
    table.add_column("feedback, V")
    for axis, figures in shadow["comparison"].items():
        active, candidate = figures["active"], figures["candidate"]
        table.add_row(
            axis,
            _pair(active["innovation_um"], candidate["innovation_um"]),
            _pair(active["feedback_V"], candidate["feedback_V"]),
        )
    return table


def _trial(shadow: Shadow) -> Table:
    table = Table("axis", "before", "on trial", "limit", title="Error rms, um")
    for axis, error in shadow["trial"].items():
        table.add_row(axis, _number(error["before_um"]), _number(error["now_um"]), _number(error["limit_um"]))
    return table


def _pair(active: float | None, candidate: float | None) -> str:
    return "-" if active is None and candidate is None else f"{_number(active)} -> {_number(candidate)}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
