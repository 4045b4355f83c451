"""``micromanip audit``: who asked for what, and when."""

from __future__ import annotations

from collections.abc import Callable

import click

from micromanip.client import Client
from micromanip.replies import Audit

from .options import StrictCommand, asking
from .parameters import brief
from .prose import say


def _show(audit: Audit) -> None:
    for entry in audit["entries"]:
        if entry["missing_before"]:
            say(f"({entry['missing_before']} entries are missing here: the trail could not be written)")
        who = entry["user"] + (f" (pid {entry['pid']})" if entry["pid"] is not None else "")
        outcome = "" if entry["accepted"] else " REFUSED"
        if repeated := entry.get("repeated"):
            outcome += f" {repeated} more times, the last of them:"
        say(f"{entry['time']}  {who}  {entry['verb']}{outcome}")
        for change in entry["changes"]:
            course = f"{brief(change['old'])} -> " if entry["accepted"] else ""
            say(f"    {change['key']}: {course}{brief(change['new'])}")
        for line in (entry["reason"] or "").splitlines():
            say(f"    {line}")
    if audit["unwritten"]:
        say(f"{audit['unwritten']} entries of this run could not be written to {audit['file']}", err=True)


@click.command("audit", cls=StrictCommand, epilog="Example: micromanip audit --last 5")
@click.option("--last", type=click.IntRange(1, 1000), default=20, show_default=True, help="How many entries.")
@asking(_show)
def command(last: int) -> Callable[[Client], Audit]:
    """The newest entries of the audit trail, oldest first: arming, disarming, every change and every refusal."""
    return lambda client: client.audit(last)
