"""``micromanip arm``, ``disarm``, ``hold``, ``reset``, ``jog``: orders to the running controller, and their ``log``."""

from __future__ import annotations

from collections.abc import Callable

import click

from micromanip.client import Client
from micromanip.errors import UsageError
from micromanip.replies import Audit, Jogged

from .echo import echo
from .options import Quantity, client_command, subcommand
from .parameters import brief


def _order(name: str, send: Callable[[Client], object], taken: str, what: str) -> click.Command:
    """The command `name`: what it does, how it is sent, and what is said once it is taken."""

    def ask(client: Client) -> dict[str, bool]:
        send(client)
        return {"accepted": True}

    @subcommand(name, f"micromanip {name}", help=what)
    @client_command(lambda _: echo(taken))
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


def _show_target(jogged: Jogged) -> None:
    echo(f"axis {jogged['axis']} goes to {jogged['target_um']:g} um")


@subcommand(
    "jog", "micromanip jog x -2.5     or: micromanip jog x --to 60", context_settings={"ignore_unknown_options": True}
)
@click.argument("axis")
@click.argument("by_um", type=Quantity("Micrometres"), required=False, metavar="[BY_UM]")
@click.option(
    "--to", "to_um", type=Quantity("Micrometres"), metavar="UM",
    help="The new target, instead of a way from the present one.",
)  # fmt: skip
@client_command(_show_target)
def jog(axis: str, by_um: float | None, to_um: float | None) -> Callable[[Client], Jogged]:
    """Move AXIS by BY_UM from its present target, at the configured speed.

    Works while TRACKING, where reference.source is jog, inside reference.range_um.
    """
    if (by_um is None) == (to_um is None):
        raise UsageError("give either a way, `micromanip jog x 5`, or a target, `micromanip jog x --to 60`")
    return lambda client: client.jog(axis, by_um=by_um, to_um=to_um)


def _show_log(audit: Audit) -> None:
    for entry in audit["entries"]:
        if entry["missing_before"]:
            echo(f"({entry['missing_before']} entries are missing here: the trail could not be written)")
        who = entry["user"] + (f" (pid {entry['pid']})" if entry["pid"] is not None else "")
        outcome = "" if entry["accepted"] else " REFUSED"
        if repeated := entry.get("repeated"):
            outcome += f" {repeated} more times, the last of them:"
        echo(f"{entry['time']}  {who}  {entry['verb']}{outcome}")
        for change in entry["changes"]:
            course = f"{brief(change['old'])} -> " if entry["accepted"] else ""
            echo(f"    {change['key']}: {course}{brief(change['new'])}")
        for line in (entry["reason"] or "").splitlines():
            echo(f"    {line}")
    if audit["unwritten"]:
        echo(f"{audit['unwritten']} entries of this run could not be written to {audit['file']}", err=True)


@subcommand("log", "micromanip log --last 5")
@click.option("--last", type=click.IntRange(1, 1000), default=20, help="How many entries.")
@client_command(_show_log)
def log(last: int) -> Callable[[Client], Audit]:
    """The newest entries of the audit trail, oldest first: arming, disarming, every change and every refusal."""
    return lambda client: client.log(last)
