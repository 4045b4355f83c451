"""``micromanip status``: what the running controller does, once, or over the whole screen with keys."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path

import click

from micromanip.client import Client
from micromanip.errors import UsageError

from .echo import echo
from .options import Answer, Quantity, socket_option, subcommand, wants_json


@subcommand("status", "micromanip status --watch")
@click.option("--watch", is_flag=True, help="Go on: the full screen with keys on a terminal, a line a time elsewhere.")
@click.option("--every", "every_s", type=Quantity("Seconds", least=0.1), default=2.0, help="Seconds a line.")
@socket_option
def command(watch: bool, every_s: float, socket_path: Path) -> Answer | None:
    """What the running controller does: its state, what each axis does, its timing and path error.

    On the full screen keys arm, hold, disarm and reset, each after a question. Leaving it changes nothing.
    """
    if watch and wants_json():
        raise UsageError("--watch goes on and --json is one document: use one of them")
    with Client(socket_path) as client:
        if not watch:
            from .live import status

            report = client.status()
            return Answer(report, lambda: status(report))
        if all(stream.isatty() for stream in (sys.stdin, sys.stdout, sys.stderr)):  # textual draws on the last
            from .status_screen import StatusScreen

            StatusScreen(socket_path).run()
        else:
            with contextlib.suppress(KeyboardInterrupt):
                _print_lines(client, every_s)
    return None


def _print_lines(client: Client, every_s: float) -> None:
    """The run in one line, again and again, until the controller goes away."""
    from .live import one_line

    while True:
        report = client.status()
        echo(f"{report['state']:9}{one_line(report)}")
        time.sleep(every_s)
