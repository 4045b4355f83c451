"""``micromanip set``: change values of the running controller."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .options import StrictCommand, json_option, print_json, socket_option
from .parameters import echo_swap


@click.command(
    "set", cls=StrictCommand, epilog="Example: micromanip set axes.x.inner.K_V_per_um=0.5 axes.x.inner.Ti_ms=0.6"
)
@click.argument("assignments", nargs=-1, required=True, metavar="KEY=VALUE...")
@socket_option
@json_option
def command(assignments: tuple[str, ...], socket_path: Path, as_json: bool) -> None:
    """Change running values, all at one cycle boundary, or none of them where one is wrong.

    VALUE is written as in the file; a list or a section too: 'axes.x.hysteresis={model: none}'. The file stays as it
    is until `micromanip save`.
    """
    from micromanip.settings.text.keys import assignments_of

    changes = assignments_of(assignments)
    with Client(socket_path) as client:
        swap = client.set(changes)
    if as_json:
        print_json(swap)
    else:
        echo_swap(swap)
