"""``micromanip get``: values of the running controller."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .options import StrictCommand, json_option, print_json, socket_option
from .parameters import shown


@click.command("get", cls=StrictCommand, epilog="Example: micromanip get axes.x.inner start.lift_s")
@click.argument("keys", nargs=-1, metavar="[KEY...]")
@socket_option
@json_option
def command(keys: tuple[str, ...], socket_path: Path, as_json: bool) -> None:
    """Running values of KEYs, of all below where one is a section; all values without a KEY.

    Beside each: what changing it takes.
    """
    with Client(socket_path) as client:
        parameters = client.get(*keys)
    if as_json:
        print_json(parameters)
        return
    width = max(len(parameter["change"]) for parameter in parameters)
    for parameter in parameters:
        click.echo(f"{parameter['change']:{width}}  {parameter['key']}={shown(parameter['value'])}")
