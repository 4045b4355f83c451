"""Options and output that several commands share."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from micromanip.client import default_socket

Command = TypeVar("Command", bound=Callable[..., Any])

config_argument = click.argument("config", type=click.Path(path_type=Path), metavar="CONFIG")
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON document on standard output.")
socket_option = click.option(
    "--socket",
    "socket_path",
    type=click.Path(path_type=Path, readable=False),  # the client says whom it lets in
    default=default_socket,
    show_default="/run/micromanip/control.sock, or the user's own",
    help="Control socket.",
)


def print_json(document: Any) -> None:
    """Print `document` as the only thing on standard output; JSON has no word for what is not a finite number."""
    click.echo(json.dumps(_plain(document), indent=2, allow_nan=False))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
