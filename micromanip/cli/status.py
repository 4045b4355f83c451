"""``micromanip status``: what the running controller does."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path

import click

from micromanip.client import Client
from micromanip.errors import UsageError

from .options import Quantity, StrictCommand, json_option, print_json, socket_option
from .prose import say

_REFRESH_S = 0.2


@click.command("status", cls=StrictCommand, epilog="Example: micromanip status --watch")
@click.option("--watch", is_flag=True, help="Go on until Ctrl-C: a live view on a terminal, a line a time elsewhere.")
@click.option(
    "--every", "every_s", type=Quantity("Seconds", least=0.1), default=2.0, show_default=True, help="Seconds a line."
)
@socket_option
@json_option
def command(watch: bool, every_s: float, socket_path: Path, as_json: bool) -> None:
    """What the running controller does: its state, what each axis does, its timing and path error."""
    if watch and as_json:
        raise UsageError("--watch goes on and --json is one document: use one of them")
    with Client(socket_path) as client:
        if watch:
            with contextlib.suppress(KeyboardInterrupt):
                _watch(client, every_s)
            return
        report = client.status()
    if as_json:
        print_json(report)
        return
    from .live import status

    status(report)


def _watch(client: Client, every_s: float) -> None:
    """Show the status again and again, until the controller goes away."""
    from rich.live import Live

    from .live import one_line, watched

    if not sys.stdout.isatty():
        while True:
            report = client.status()
            say(f"{report['state']:9}{one_line(report)}")
            time.sleep(every_s)
    with Live(watched(client.status()), refresh_per_second=5, screen=True) as view:
        while True:
            time.sleep(_REFRESH_S)
            view.update(watched(client.status()))
