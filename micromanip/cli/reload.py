"""``micromanip reload``: take over the configuration file as it is now."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .options import StrictCommand, json_option, print_json, socket_option
from .parameters import echo_swap


@click.command("reload", cls=StrictCommand, epilog="Example: micromanip reload")
@socket_option
@json_option
def command(socket_path: Path, as_json: bool) -> None:
    """Take over the configuration file as it is now, all of it or nothing; as SIGHUP does.

    Refused where it is not valid, or where a change needs disarm or a restart.
    """
    with Client(socket_path) as client:
        swap = client.reload()
    if as_json:
        print_json(swap)
    else:
        echo_swap(swap)
