"""``micromanip drivers``: what is installed, and does it keep its contract?"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from micromanip.errors import CheckFailed

from .options import StrictCommand, json_option, print_json
from .prose import say

if TYPE_CHECKING:
    from micromanip.bus.inspection import Inspected


@click.command("drivers", cls=StrictCommand, epilog="Example: micromanip drivers")
@json_option
def command(as_json: bool) -> None:
    """List the installed drivers: kind, package and version, where each comes from, what is wrong with it.

    Each is loaded and its class is looked at; nothing is opened, no hardware is needed. Exit code 1 if one of them
    can't be loaded or does not keep its contract. `loads` is no more than that: `run` compiles it, and what it does on
    its bus is for its author's conformance tests to show (docs/bus-drivers.md).
    """
    from micromanip.bus.inspection import inspected

    found = inspected()
    if as_json:
        print_json({"drivers": [{**asdict(driver), "ok": not driver.problems} for driver in found]})
    else:
        _print(found)
    broken = [driver.name for driver in found if driver.problems]
    if broken:
        raise CheckFailed(f"{'driver' if len(broken) == 1 else 'drivers'} {', '.join(broken)} can't be used")


def _print(found: list[Inspected]) -> None:
    if not found:
        say("no driver is installed: install the package of one into this environment (docs/drivers.md)")
    width = max((len(driver.name) for driver in found), default=0)
    for driver in found:
        verdict = "BROKEN" if driver.problems else "loads"
        say(f"{driver.name:{width}}  {driver.kind or '?':6}  {verdict:6}  {driver.package} {driver.version}")
        say(f"{'':{width}}  {driver.entry_point}{f' in {driver.file}' if driver.file else ''}")
        for problem in driver.problems:
            say(f"{'':{width}}  {problem}")
