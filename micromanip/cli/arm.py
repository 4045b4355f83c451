"""``micromanip arm`` on a running controller."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .options import StrictCommand, json_option, print_json, socket_option


@click.command("arm", cls=StrictCommand, epilog="Example: micromanip arm")
@socket_option
@json_option
def command(socket_path: Path, as_json: bool) -> None:
    """Start tracking, softly: lift to the working point, close the loops, fade the correction in."""
    with Client(socket_path) as client:
        client.arm()
    if as_json:
        print_json({"accepted": True})
    else:
        click.echo("arming")
