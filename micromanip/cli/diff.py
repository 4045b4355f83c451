"""``micromanip diff``: the configuration file against what runs."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .options import StrictCommand, json_option, print_json, socket_option
from .parameters import brief


@click.command("diff", cls=StrictCommand, epilog="Example: micromanip diff")
@socket_option
@json_option
def command(socket_path: Path, as_json: bool) -> None:
    """Values of the configuration file, as it is on disk now, that are not the running ones."""
    with Client(socket_path) as client:
        found = client.diff()
    if as_json:
        print_json(found)
        return
    click.echo(f"{found['file']}{': edited since it was loaded' if found['changed_on_disk'] else ''}")
    for difference in found["differences"]:
        click.echo(f"  {difference['key']}: file {brief(difference['file'])}, running {brief(difference['running'])}")
    if not found["differences"]:
        click.echo("  says what runs")
