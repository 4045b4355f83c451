"""``micromanip reset`` on a running controller."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .options import StrictCommand, json_option, print_json, socket_option


@click.command("reset", cls=StrictCommand, epilog="Example: micromanip reset")
@socket_option
@json_option
def command(socket_path: Path, as_json: bool) -> None:
    """Clear a latched fault; nothing moves, and it stays disarmed."""
    with Client(socket_path) as client:
        client.reset()
    if as_json:
        print_json({"accepted": True})
    else:
        click.echo("fault cleared")
