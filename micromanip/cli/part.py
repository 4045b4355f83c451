"""``micromanip part``: where a part begins and ends, for cells whose machine does not say so itself."""

from __future__ import annotations

from collections.abc import Callable

import click

from micromanip.client import Client

from .options import StrictCommand, asking


@click.group("part", epilog="Example: micromanip part begin")
def command() -> None:
    """Tell the running controller that a part begins or ends: what learns from part to part wants to know.

    Not where the configuration has the signal `part`: then the machine says it. docs/learning.md explains it.
    """


@command.command("begin", cls=StrictCommand, epilog="Example: micromanip part begin")
@asking(lambda _: click.echo("a part begins"))
def begin() -> Callable[[Client], dict[str, bool]]:
    """A part begins now; the tracker's path says when exactly."""
    return lambda client: _ordered(client.part_begin)


@command.command("end", cls=StrictCommand, epilog="Example: micromanip part end")
@asking(lambda _: click.echo("the part has ended"))
def end() -> Callable[[Client], dict[str, bool]]:
    """The part has ended, or was broken off: what is played for it fades out."""
    return lambda client: _ordered(client.part_end)


def _ordered(order: Callable[[], None]) -> dict[str, bool]:
    order()
    return {"accepted": True}
