"""``micromanip hold`` on a running controller."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .options import StrictCommand, json_option, print_json, socket_option


@click.command("hold", cls=StrictCommand, epilog="Example: micromanip hold")
@socket_option
@json_option
def command(socket_path: Path, as_json: bool) -> None:
    """Freeze the correction: every axis stays where it is, its loops closed. `micromanip arm` goes on."""
    with Client(socket_path) as client:
        client.hold()
    if as_json:
        print_json({"accepted": True})
    else:
        click.echo("holding")
