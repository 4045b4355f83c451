"""``micromanip promote``: put the candidate tuning in force, on trial."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client
from micromanip.errors import CheckFailed

from .candidate import echo_shadow, standing_line
from .options import StrictCommand, json_option, print_json, socket_option


@click.command("promote", cls=StrictCommand, epilog="Example: micromanip promote --wait")
@click.option("--wait", is_flag=True, help="Wait for the end of the trial; exit code 1 where it is not confirmed.")
@socket_option
@json_option
def command(wait: bool, socket_path: Path, as_json: bool) -> None:
    """Put the candidate in force at one cycle boundary, without a bump.

    It is on trial for `shadow.trial_s`: where the error grows beyond its limit, an inner loop begins to swing, or the
    tracking ends, what ran before is in force again by itself.
    """
    with Client(socket_path) as client:
        shadow = client.promote()
        if wait:
            click.echo(standing_line(shadow), err=True)
            shadow = client.trial()
    if as_json:
        print_json(shadow)
    else:
        echo_shadow(shadow)
    if wait and shadow["standing"] != "confirmed":
        raise CheckFailed(f"the promoted tuning is not in force any more: {shadow['standing']}")
