"""``micromanip view``: the scope on a recording."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.extras import required

from .options import StrictCommand
from .prose import say


@click.command("view", cls=StrictCommand, epilog="Example: micromanip view out/run.mcap")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option(
    "--listen", default="127.0.0.1:8091", show_default=True, metavar="HOST:PORT", help="Where browsers find it."
)
def command(file: Path, listen: str) -> None:
    """Show a recording of ours as the scope shows a running cell.

    Zoom from 1 ms to the whole file, spectrum, x-y, states, faults and remarks. Of a long file it makes an overview
    meanwhile, which is kept in the user's cache; browsers of this computer need no token. It needs the extra `gateway`.
    """
    with required("view", "gateway"):
        from micromanip.gateway.viewing import view
    view(file, listen, lambda line: say(line, err=True))
