"""``micromanip status``: what the running controller does, once, or over the whole screen with keys."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from micromanip.client import Client
from micromanip.errors import UsageError

from .options import Answer, socket_option, subcommand, wants_json


@subcommand("status", "micromanip status --watch")
@click.option("--watch", is_flag=True, help="Go on: the full screen of a terminal, with keys.")
@socket_option
def command(watch: bool, socket_path: Path) -> Answer | None:
    """What the running controller does: its state, what each axis does, its timing and path error.

    On the full screen keys arm, hold, disarm and reset, each after a question. Leaving it changes nothing.
    """
    if watch and wants_json():
        raise UsageError("--watch goes on and --json is one document: use one of them")
    with Client(socket_path) as client:
        report = client.status()
    if not watch:
        from .live import status

        return Answer(report, lambda: status(report))
    if not all(stream.isatty() for stream in (sys.stdin, sys.stdout, sys.stderr)):  # textual draws on the last
        raise UsageError("--watch takes a terminal; `micromanip get --watch NAME...` prints a line a sample elsewhere")
    from .status_screen import StatusScreen

    StatusScreen(socket_path).run()
    return None
