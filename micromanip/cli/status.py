"""``micromanip status``: what the running controller does."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .options import json_option, print_json, socket_option


@click.command("status", epilog="Example: micromanip status --json")
@socket_option
@json_option
def command(socket_path: Path, as_json: bool) -> None:
    """State, timing and path error of the running controller."""
    with Client(socket_path) as client:
        report = client.status()
    if as_json:
        print_json(report)
        return
    from .live import summary

    summary(report)
