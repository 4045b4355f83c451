"""``micromanip safe-outputs``: all outputs to their safe value, with no controller running."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.errors import DeviceUnavailable

from .options import Quantity, StrictCommand, config_argument, json_option, print_json


@click.command("safe-outputs", cls=StrictCommand, epilog="Example: micromanip safe-outputs /etc/micromanip/cell.yaml")
@config_argument
@click.option(
    "--wait",
    "wait_s",
    type=Quantity("SecondsOrZero"),
    default=0.0,
    metavar="S",
    help="Wait so long for a controller that is still ramping down.",
)
@json_option
def command(config: Path, wait_s: float, as_json: bool) -> None:
    """Bring every output of CONFIG's drivers to its safe value; does no harm where they are.

    Refused (exit code 1) while a controller has one of the devices: use `micromanip disarm`, or stop it.
    """
    from micromanip.host.safe_outputs import drivers_of, make_safe

    drivers = drivers_of(config)
    problems = make_safe(drivers, wait_s)
    if as_json:
        print_json(
            {"drivers": {name: {"device": driver.device} for name, driver in drivers.items()}, "failed": problems}
        )
    elif not problems:
        click.echo(f"outputs at their safe value: {', '.join(drivers)}")
    if problems:
        raise DeviceUnavailable("; ".join(problems))
