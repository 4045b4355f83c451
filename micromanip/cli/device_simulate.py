"""``micromanip device simulate``: the devices that a configuration names, on their real protocols."""

from __future__ import annotations

import gc
import json
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .echo import echo
from .options import Answer, Quantity, claim_json, config_argument, subcommand, wants_json

if TYPE_CHECKING:
    from micromanip.emulation.devices import Devices


@subcommand("simulate", "micromanip device simulate config/can.yaml")
@config_argument
@click.option("--duration", "duration_s", type=Quantity("Duration"), help="End after so many seconds.")
@click.option("--seed", type=Quantity("Seed"), help="In place of the seed in the section simulation.")
@click.option(
    "--watchdog",
    "watchdog_ms",
    type=Quantity("Milliseconds"),
    default=100.0,
    metavar="MS",
    help="Without a command for so long an amplifier ramps to rest.",
)
@click.option(
    "--commands",
    is_flag=True,
    help="Take faults as lines of JSON from standard input, and answer each with a line; ends with the input. E.g. "
    '{"device": "freeze", "signal": "strain_x", "for_s": 1}',
)
def command(
    config: Path, duration_s: float | None, seed: int | None, watchdog_ms: float, commands: bool
) -> Answer | None:
    """Play every device that CONFIG names, with the plant of its section simulation behind them, until Ctrl-C.

    Says READY on standard error as soon as a controller may connect.
    """
    from micromanip.emulation.devices import Devices, take_precedence

    devices = Devices(config, watchdog_ms, seed)
    if commands:
        claim_json()  # a line for each answer, and none for what ends them
    take_precedence(devices.loop_cpu)
    gc.collect()
    gc.freeze()  # to look through all that was imported would make a stall now and then
    try:
        for device in devices.emulated.values():
            click.echo(f"READY {device.ready}", err=True)
        _play(devices, duration_s, commands)
        report = devices.report()
    finally:
        devices.close()
    if not commands:
        return Answer(report, lambda: _summary(report))
    if wants_json():
        click.echo(json.dumps(report))  # a line, as every answer
    return None


def _play(devices: Devices, duration_s: float | None, commands: bool) -> None:
    loop = devices.loop
    for ending in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ending, lambda *_: loop.stop())
    if commands:
        loop.add_reader(sys.stdin.fileno(), _Lines(devices).read)
    devices.start()
    loop.run(None if duration_s is None else loop.now_ns() + round(duration_s * 1e9))


class _Lines:
    """Standard input as it comes, split into lines."""

    def __init__(self, devices: Devices) -> None:
        self._devices, self._rest = devices, b""

    def read(self) -> None:
        """Answer the lines that are complete."""
        received = os.read(sys.stdin.fileno(), 65536)
        if not received:
            self._devices.loop.stop()
            return
        *lines, self._rest = (self._rest + received).split(b"\n")
        for line in lines:
            if line.strip():
                click.echo(json.dumps(self._devices.command(line.decode(errors="replace"))))


def _summary(report: dict[str, Any]) -> None:
    """The figures as tables."""
    from .tables import print_table

    keys = ("frames", "sent", "received", "not_sent", "bus_load_percent")
    rows = [(name, *(str(device.get(key, "-")) for key in keys)) for name, device in report["devices"].items()]
    print_table(("driver", "frames", "sent", "received", "not sent", "load, %"), rows, "Buses")
    rows = [
        (name, str(output["samples"]), *_three_digits(output["min"], output["max"], output["largest_step_V"]))
        for name, output in report["outputs"].items()
    ]
    print_table(("output", "commands", "min, V", "max, V", "largest step, V"), rows, "What arrived")
    errors = report["path_error_um"]
    figures = ("uncompensated_rms", "rms", "max")
    rows = [(axis, *_three_digits(*map(error.get, figures))) for axis, error in errors.items()]
    print_table(("axis", "uncompensated rms", "rms", "max"), rows, "Path error at the spindle, um")
    stalls = report["stalls"]
    echo(
        f"{report['elapsed_s']:.1f} s, {report['cpu_s']:.1f} s of CPU; {stalls['count']} stalls of the machine, "
        f"the longest {stalls['longest_ms']:.0f} ms; the amplifiers' watchdogs came {report['amplifier_trips']} times"
    )


def _three_digits(*values: float | None) -> list[str]:
    return ["-" if value is None else f"{value:.3f}" for value in values]
