"""``micromanip save``: write running values into the configuration file."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .options import StrictCommand, json_option, print_json, socket_option
from .parameters import echo_changes


@click.command("save", cls=StrictCommand, epilog="Example: micromanip save")
@click.option("--force", is_flag=True, help="Also where the file was edited since it was loaded.")
@socket_option
@json_option
def command(force: bool, socket_path: Path, as_json: bool) -> None:
    """Write the running values into the configuration file; only changed keys change, comments stay."""
    with Client(socket_path) as client:
        saved = client.save(force=force)
    if as_json:
        print_json(saved)
        return
    click.echo(f"{saved['file']}: {'written' if saved['changed'] else 'says what runs already'}")
    echo_changes(saved["changed"])
