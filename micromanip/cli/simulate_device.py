"""``micromanip simulate-device``: the devices that a configuration names, on their real protocols."""

from __future__ import annotations

import gc
import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .options import Quantity, StrictCommand, config_argument, json_option, pay_json, print_json

if TYPE_CHECKING:
    from micromanip.emulation.devices import Devices

_LINE_EVERY_NS = 500_000_000


@click.command("simulate-device", cls=StrictCommand, epilog="Example: micromanip simulate-device config/can.yaml")
@config_argument
@click.option("--duration", "duration_s", type=Quantity("Duration"), help="End after so many seconds.")
@click.option("--seed", type=Quantity("Seed"), help="In place of the seed in the section simulation.")
@click.option(
    "--watchdog",
    "watchdog_ms",
    type=Quantity("Milliseconds"),
    default=100.0,
    show_default=True,
    metavar="MS",
    help="Without a command for so long an amplifier ramps to rest.",
)
@click.option(
    "--commands",
    is_flag=True,
    help="Take faults as lines of JSON from standard input, and answer each with a line; ends with the input. E.g. "
    '{"device": "freeze", "signal": "strain_x", "for_s": 1}',
)
@json_option
def command(
    config: Path, duration_s: float | None, seed: int | None, watchdog_ms: float, commands: bool, as_json: bool
) -> None:
    """Play every device that CONFIG names, with the plant of its section simulation behind them, until Ctrl-C.

    Says READY on standard error as soon as a controller may connect.
    """
    from micromanip.emulation.devices import Devices, take_precedence

    devices = Devices(config, watchdog_ms, seed)
    if commands:
        pay_json()  # a line for each answer, and none for what ends them
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
    if as_json and commands:
        click.echo(json.dumps(report))  # a line, as every answer
    elif as_json:
        print_json(report)
    elif not commands:
        _summary(report)


def _play(devices: Devices, duration_s: float | None, commands: bool) -> None:
    loop = devices.loop
    for ending in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ending, lambda *_: loop.stop())
    if commands:
        loop.add_reader(sys.stdin.fileno(), _Lines(devices).read)
    line = _StatusLine(devices) if sys.stderr.isatty() else None
    try:
        devices.start()
        loop.run(None if duration_s is None else loop.now_ns() + round(duration_s * 1e9))
    finally:
        if line is not None:
            line.close()


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


class _StatusLine:
    """Frames, bus load and voltages on the last line of the terminal."""

    def __init__(self, devices: Devices) -> None:
        from rich.console import Console
        from rich.live import Live

        self._devices = devices
        self._live = Live(console=Console(stderr=True, highlight=False), auto_refresh=False, transient=True)
        self._live.start()
        self._before: dict[str, int] = {}
        self._before_s = time.monotonic()
        self._again()

    def close(self) -> None:
        """Give the terminal back."""
        self._live.stop()

    def _again(self) -> None:
        self._devices.loop.call_at(self._devices.loop.now_ns() + _LINE_EVERY_NS, self._show)

    def _show(self) -> None:
        now_s = time.monotonic()
        parts = []
        for name, device in self._devices.emulated.items():
            report = device.report()
            rate = (report["frames"] - self._before.get(name, 0)) / (now_s - self._before_s)
            parts.append(f"{name} {rate:.0f} frames/s, load {report['bus_load_percent']:.0f} %")
            self._before[name] = report["frames"]
        self._before_s = now_s
        voltages = [f"{name} {volts:.2f}" for name, volts in self._devices.cell.voltages().items()]
        self._live.update("  ".join([*parts, *voltages]), refresh=True)
        self._again()


def _summary(report: dict[str, Any]) -> None:
    """The figures as tables."""
    from .tables import Figures, out_console

    console = out_console()
    buses = Figures("driver", "frames", "sent", "received", "not sent", "load, %", title="Buses")
    for name, device in report["devices"].items():
        keys = ("frames", "sent", "received", "not_sent", "bus_load_percent")
        buses.add_row(name, *(str(device.get(key, "-")) for key in keys))  # a CANopen node counts frames only
    outputs = Figures("output", "commands", "min, V", "max, V", "largest step, V", title="What arrived")
    for name, output in report["outputs"].items():
        volts = (output["min"], output["max"], output["largest_step_V"])
        outputs.add_row(name, str(output["samples"]), *("-" if v is None else f"{v:.3f}" for v in volts))
    errors = Figures("axis", "uncompensated rms", "rms", "max", title="Path error at the spindle, um")
    for axis, error in report["path_error_um"].items():
        shown = (error.get(key) for key in ("uncompensated_rms", "rms", "max"))
        errors.add_row(axis, *("-" if value is None else f"{value:.3f}" for value in shown))
    stalls = report["stalls"]
    console.print(buses, outputs, errors)
    console.print(
        f"{report['elapsed_s']:.1f} s, {report['cpu_s']:.1f} s of CPU; {stalls['count']} stalls of the machine, "
        f"the longest {stalls['longest_ms']:.0f} ms; the amplifiers' watchdogs came {report['amplifier_trips']} times"
    )
