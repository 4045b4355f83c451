"""``micromanip disarm`` on a running controller."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .options import StrictCommand, json_option, print_json, socket_option


@click.command("disarm", cls=StrictCommand, epilog="Example: micromanip disarm")
@socket_option
@json_option
def command(socket_path: Path, as_json: bool) -> None:
    """Stop tracking, softly: ramp every output to its park voltage."""
    with Client(socket_path) as client:
        client.disarm()
    if as_json:
        print_json({"accepted": True})
    else:
        click.echo("ramping to park")
