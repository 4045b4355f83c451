"""``micromanip jog``: move an axis by hand."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client
from micromanip.errors import UsageError

from .options import Quantity, StrictCommand, json_option, print_json, socket_option


@click.command(
    "jog",
    cls=StrictCommand,
    context_settings={"ignore_unknown_options": True},
    epilog="Example: micromanip jog x -2.5     or: micromanip jog x --to 60",
)
@click.argument("axis")
@click.argument("by_um", type=Quantity("Micrometres"), required=False, metavar="[BY_UM]")
@click.option(
    "--to",
    "to_um",
    type=Quantity("Micrometres"),
    metavar="UM",
    help="The new target, instead of a way from the present one.",
)
@socket_option
@json_option
def command(axis: str, by_um: float | None, to_um: float | None, socket_path: Path, as_json: bool) -> None:
    """Move AXIS by BY_UM from its present target, at the configured speed.

    Works while TRACKING, where reference.source is jog, inside reference.range_um.
    """
    if (by_um is None) == (to_um is None):
        raise UsageError("give either a way, `micromanip jog x 5`, or a target, `micromanip jog x --to 60`")
    with Client(socket_path) as client:
        jogged = client.jog(axis, by_um=by_um, to_um=to_um)
    if as_json:
        print_json(jogged)
    else:
        click.echo(f"axis {jogged['axis']} goes to {jogged['target_um']:g} um")
