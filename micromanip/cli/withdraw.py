"""``micromanip withdraw``: let the candidate tuning go, or take it back."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .candidate import echo_shadow
from .options import StrictCommand, json_option, print_json, socket_option


@click.command("withdraw", cls=StrictCommand, epilog="Example: micromanip withdraw")
@socket_option
@json_option
def command(socket_path: Path, as_json: bool) -> None:
    """Let the candidate go; where it is on trial, what ran before is in force again in the same cycle."""
    with Client(socket_path) as client:
        shadow = client.withdraw()
    if as_json:
        print_json(shadow)
    else:
        echo_shadow(shadow)
