"""``micromanip part``: where a part begins and ends, for cells whose machine does not say so itself."""

from __future__ import annotations

from collections.abc import Callable

import click

from micromanip.client import Client

from .options import Quantity, StrictCommand, StrictGroup, asking
from .prose import say


@click.group("part", cls=StrictGroup, epilog="Example: micromanip part begin")
def command() -> None:
    """Tell the running controller that a part begins or ends: what learns from part to part wants to know.

    Not where the configuration has the signal `part`: then the machine says it. docs/learning.md explains it.
    """


@command.command("begin", cls=StrictCommand, epilog="Example: micromanip part begin --tool 3")
@click.option(
    "--tool", type=Quantity("Count", most=65_535), metavar="N",
    help="The tool in the spindle: what was learned with it is played.  [default: none is told]",
)  # fmt: skip
@asking(lambda _: say("a part begins"))
def begin(tool: int | None) -> Callable[[Client], dict[str, bool]]:
    """A part begins now; the tracker's path says when exactly."""
    return lambda client: _ordered(lambda: client.part_begin(tool))


@command.command("end", cls=StrictCommand, epilog="Example: micromanip part end")
@asking(lambda _: say("the part has ended"))
def end() -> Callable[[Client], dict[str, bool]]:
    """The part has ended, or was broken off: what is played for it fades out."""
    return lambda client: _ordered(client.part_end)


def _ordered(order: Callable[[], None]) -> dict[str, bool]:
    order()
    return {"accepted": True}
