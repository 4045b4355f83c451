"""``micromanip shadow``: a candidate tuning beside the one that runs."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .candidate import echo_shadow
from .options import StrictCommand, json_option, print_json, socket_option


@click.command("shadow", cls=StrictCommand, epilog="Example: micromanip shadow axes.x.outer.effort=12")
@click.argument("assignments", nargs=-1, metavar="[KEY=VALUE...]")
@socket_option
@json_option
def command(assignments: tuple[str, ...], socket_path: Path, as_json: bool) -> None:
    """Let a candidate compute beside what runs, on the same samples; nothing of it is written to the outputs.

    The candidate is what runs, with these values instead; only values that `set` takes while tracking. Without any:
    where the candidate stands and how it compares with what runs; the smaller figure is the better one. `micromanip
    promote` puts it in force.
    """
    from micromanip.settings.text.keys import assignments_of

    changes = assignments_of(assignments) if assignments else {}
    with Client(socket_path) as client:
        shadow = client.shadow(changes)
    if as_json:
        print_json(shadow)
    else:
        echo_shadow(shadow)
