"""``micromanip park``: all outputs to their safe value, with no controller running."""

from __future__ import annotations

from pathlib import Path

import click

from micromanip.errors import DeviceUnavailable

from .echo import echo
from .options import Answer, Quantity, config_argument, subcommand, warn


@subcommand("park", "micromanip park /etc/micromanip/cell.yaml")
@config_argument
@click.option(
    "--wait",
    "wait_s",
    type=Quantity("SecondsOrZero"),
    default=0.0,
    metavar="S",
    help="Wait so long for a controller that is still ramping down.",
)
@click.option("--from-file", is_flag=True, help="Go by CONFIG as it is now, not by what last ran with it.")
@click.option(
    "--at-rest",
    is_flag=True,
    help="You have seen that the outputs are at their safe values: begin there where a device can't tell.",
)
def command(config: Path, wait_s: float, from_file: bool, at_rest: bool) -> Answer:
    """Bring every output of CONFIG's drivers to its safe value; does no harm where they are.

    What is safe is what was in force when CONFIG last ran; CONFIG itself where it never ran here, if it is valid. With
    neither, nothing is touched (exit code 78).

    Voltages ramp within range and slew limit from where they are. What a device has not taken is told (exit code 69).

    Refused (exit code 1) while a controller has one of the devices: use `micromanip disarm`, or stop it.
    """
    from micromanip.host.safe.outputs import make_safe
    from micromanip.host.safe.plan import plan_of

    plan = plan_of(config, from_file=from_file)
    warn(plan.warnings)
    report = make_safe(plan, wait_s, at_rest=at_rest)
    warn(report.notes)
    document = {
        "drivers": {name: {"device": driver.device} for name, driver in plan.wiring.drivers.items()},
        "failed": report.failed,
        "safe": report.safe,
        "source": {"file": str(plan.file), "taken": plan.taken},
        "warnings": [*plan.warnings, *report.notes],
    }

    def show() -> None:
        if report.safe:
            echo(f"outputs at their safe value: {', '.join(report.safe)}")
        echo(plan.said)

    return Answer(document, show, DeviceUnavailable("\n".join(report.failed)) if report.failed else None)
