"""``micromanip audit``: who asked for what, and when."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.client import Client

from .options import StrictCommand, json_option, print_json, socket_option
from .parameters import brief


@click.command("audit", cls=StrictCommand, epilog="Example: micromanip audit --last 5")
@click.option("--last", type=click.IntRange(1, 1000), default=20, show_default=True, help="How many entries.")
@socket_option
@json_option
def command(last: int, socket_path: Path, as_json: bool) -> None:
    """The newest entries of the audit trail, oldest first: arming, disarming, every change and every refusal."""
    with Client(socket_path) as client:
        audit = client.audit(last)
    if as_json:
        print_json(audit)
        return
    for entry in audit["entries"]:
        if entry["missing_before"]:
            click.echo(f"({entry['missing_before']} entries are missing here: the trail could not be written)")
        who = entry["user"] + (f" (pid {entry['pid']})" if entry["pid"] is not None else "")
        outcome = "" if entry["accepted"] else " REFUSED"
        if repeated := entry.get("repeated"):
            outcome += f" {repeated} more times, the last of them:"
        click.echo(f"{entry['time']}  {who}  {entry['verb']}{outcome}")
        for change in entry["changes"]:
            course = f"{brief(change['old'])} -> " if entry["accepted"] else ""
            click.echo(f"    {change['key']}: {course}{brief(change['new'])}")
        for line in (entry["reason"] or "").splitlines():
            click.echo(f"    {line}")
    if audit["unwritten"]:
        click.echo(f"{audit['unwritten']} entries of this run could not be written to {audit['file']}", err=True)
