"""``micromanip fit``: models from a recording."""

from __future__ import annotations

import click

from .fit_hysteresis import command as hysteresis
from .fit_linear import command as linear


@click.group("fit")
def command() -> None:
    """Fit models to a recording, ours or any CSV."""


command.add_command(hysteresis)
command.add_command(linear)
