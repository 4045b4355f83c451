"""``micromanip arm``, ``disarm``, ``hold``, ``reset``: one word to a running controller, which takes or refuses it."""

from __future__ import annotations

from collections.abc import Callable

import click

from micromanip.client import Client

from .options import StrictCommand, asking
from .prose import say


def _order(name: str, send: Callable[[Client], object], taken: str, what: str) -> click.Command:
    """The command `name`: what it does, how it is sent, and what is said once it is taken."""

    def ask(client: Client) -> dict[str, bool]:
        send(client)
        return {"accepted": True}

    @click.command(name, cls=StrictCommand, help=what, epilog=f"Example: micromanip {name}")
    @asking(lambda _: say(taken))
    def command() -> Callable[[Client], dict[str, bool]]:
        return ask

    return command


arm = _order(
    "arm",
    Client.arm,
    "arming",
    "Start tracking, softly: lift to the working point, close the loops, fade the correction in.",
)
disarm = _order(
    "disarm", Client.disarm, "ramping to park", "Stop tracking, softly: ramp every output to its park voltage."
)
hold = _order(
    "hold",
    Client.hold,
    "holding",
    "Freeze the correction: every axis stays where it is, its loops closed. `micromanip arm` goes on.",
)
reset = _order("reset", Client.reset, "fault cleared", "Clear a latched fault; nothing moves, and it stays disarmed.")
