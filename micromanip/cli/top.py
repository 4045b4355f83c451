"""``micromanip top``: the running controller over the whole screen, live, with keys."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from micromanip.client import Client
from micromanip.errors import UsageError

from .options import StrictCommand, socket_option


@click.command("top", cls=StrictCommand, epilog="Example: micromanip top")
@socket_option
def command(socket_path: Path) -> None:
    """State, faults, each axis and its error, five times a second.

    Keys arm, hold, disarm and reset, each after a question. Leaving it changes nothing.
    It needs a terminal.
    """
    from .top_screen import Top

    if not all(stream.isatty() for stream in (sys.stdin, sys.stdout, sys.stderr)):  # textual draws on the last
        raise UsageError("top needs a terminal; `micromanip status --watch` prints a line now and then anywhere")
    Client(socket_path).close()  # who starts it without a controller is told at once
    Top(socket_path).run()
