"""``micromanip fit``: models from a recording."""

from __future__ import annotations

import click

from .fit_hysteresis import command as hysteresis
from .fit_linear import command as linear
from .fit_tracker import command as tracker
from .options import StrictGroup


@click.group("fit", cls=StrictGroup, epilog="Example: micromanip fit hysteresis x.csv --input u --output y")
def command() -> None:
    """Fit models to a recording, ours or any CSV."""


command.add_command(hysteresis)
command.add_command(linear)
command.add_command(tracker)
