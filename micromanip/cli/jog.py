"""``micromanip jog``: move an axis by hand."""

from __future__ import annotations

from collections.abc import Callable

import click

from micromanip.client import Client
from micromanip.errors import UsageError
from micromanip.replies import Jogged

from .axis_names import complete_axis
from .options import Quantity, StrictCommand, asking
from .prose import say


def _show(jogged: Jogged) -> None:
    say(f"axis {jogged['axis']} goes to {jogged['target_um']:g} um")


@click.command(
    "jog",
    cls=StrictCommand,
    context_settings={"ignore_unknown_options": True},
    epilog="Example: micromanip jog x -2.5     or: micromanip jog x --to 60",
)
@click.argument("axis", shell_complete=complete_axis)
@click.argument("by_um", type=Quantity("Micrometres"), required=False, metavar="[BY_UM]")
@click.option(
    "--to",
    "to_um",
    type=Quantity("Micrometres"),
    metavar="UM",
    help="The new target, instead of a way from the present one.",
)
@asking(_show)
def command(axis: str, by_um: float | None, to_um: float | None) -> Callable[[Client], Jogged]:
    """Move AXIS by BY_UM from its present target, at the configured speed.

    Works while TRACKING, where reference.source is jog, inside reference.range_um.
    """
    if (by_um is None) == (to_um is None):
        raise UsageError("give either a way, `micromanip jog x 5`, or a target, `micromanip jog x --to 60`")
    return lambda client: client.jog(axis, by_um=by_um, to_um=to_um)
