"""``micromanip new``: a small configuration to begin one's own cell with, untuned."""

from __future__ import annotations

import contextlib
import itertools
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import click

from micromanip.errors import DeviceUnavailable, UsageError, nearest
from micromanip.shipped import shipped

from .echo import echo
from .options import Answer, Quantity, subcommand

_LOCAL = {"canbus": "can0", "canopen": "can0", "ethercat": "eth1", "line_binary": "/dev/ttyUSB0"}
"""Where a driver's address is an interface or a port of this machine; the others have one in the network."""
_ADDRESS = "192.168.0.10"
_RATE_HZ = {"modbus": 250, "line": 100, "line_binary": 100}
"""Of a bus; the others can do 1000."""
_ALSO_CALLED = {"can": "canbus", "gcs": "line", "rtu": "modbus", "serial": "line_binary"}
_IN_THE_LOOP = ("simulated", "udp", "ethercat")
_FULL_RATE_HZ, _BUS_LOOP_HZ = 10_000, 2000
_PORTS = {"modbus": 502, "line": 50000, "udp": 4840}
_PROBE_S = 20.0
_SENSOR = re.compile(r"\?(stage|tracker) ")
"""What begins a line that is there with such a sensor only."""
_COUNTED = re.compile(r"\{(?:(\d+)\+)?(\d*)([ik])\}")
"""A number that grows with the axis: ``{100+2i}`` is 100, 102, 104; with k, with each such line of the file."""


@subcommand("new", "micromanip new --driver modbus --axes z --address 10.0.0.7 > cell.yaml")
@click.option("--driver", metavar="NAME", help="Driver of the device; --list shows them.")
@click.option("--axes", default="x", metavar="X,Y", help="Names of the axes.")
@click.option("--address", metavar="WHERE", help="Host of the device, or interface or port of this machine.")
@click.option("--rate", "rate_hz", type=Quantity("Hertz", least=10, most=20_000), help="Samples a second.")
@click.option("--stage", is_flag=True, help="Each axis has a sensor of its stage, too.")
@click.option("--tracker", is_flag=True, help="A tracker sees the deviation along each axis.")
@click.option("--probe", is_flag=True, help="Look what answers there; no output is written.")
@click.option("--list", "lists", is_flag=True, help="Show the drivers and the examples that come with the program.")
def command(
    driver: str | None, axes: str, address: str | None, rate_hz: float | None, stage: bool, tracker: bool, probe: bool,
    lists: bool,
) -> Answer:  # fmt: skip
    """Print a small configuration of your own cell, untuned.

    Registers, messages and channels in it are an example: put those of the device's manual in their place. What only
    you can know is left out, and `check` asks for it: ranges, slew limits, working point. Then `device probe`,
    and `commission`.
    """
    examples = [str(file) for file in sorted(shipped("config").glob("*.yaml"))]
    if lists:
        said = [f"drivers: {', '.join(_drivers())}", "examples, tuned, each beside `micromanip device simulate`:"]
        said += [f"  {file}" for file in examples]
        return Answer({"drivers": _drivers(), "examples": examples}, lambda: echo("\n".join(said)))
    if driver is None:
        raise UsageError(f"--driver is missing: one of {', '.join(_drivers())}")
    sensors = [name for name, is_there in (("stage", stage), ("tracker", tracker)) if is_there]
    text = text_for(driver, _names(axes), address, rate_hz, sensors)
    found = _answers(text) if probe else []
    for line in found:
        echo(line, err=True)
    shown = "".join(f"# found: {line}\n" for line in found) + text.rstrip("\n")
    return Answer({"configuration": text, "found": found}, lambda: echo(shown))


def _answers(text: str) -> list[str]:
    """A line for each that answers where the configuration leads. Raises DeviceUnavailable; Ctrl-C ends it early."""
    from micromanip.bus.device_lock import DeviceLocks
    from micromanip.bus.errors import BusError
    from micromanip.settings.text.source import Source
    from micromanip.settings.wiring.single_driver import discovered

    (section,) = Source.parse(Path("cell.yaml"), text).data["drivers"].values()
    device, answers = discovered(section, _PROBE_S)
    newest = {}
    with DeviceLocks((device,)), contextlib.suppress(KeyboardInterrupt):
        try:
            for answer in answers:
                newest[answer.name] = answer
        except BusError as problem:
            raise DeviceUnavailable(str(problem)) from problem
    if not newest:
        raise DeviceUnavailable(
            f"nothing answered on {device}; check power, cable, address and rate of the line, or leave --probe out"
        )
    said = ((each, ", ".join(f"{name} {value}" for name, value in each.values.items())) for each in newest.values())
    return [f"{each.name}: {values}{f' ({each.note})' if each.note else ''}" for each, values in said]


def text_for(
    driver: str, axes: Sequence[str], address: str | None = None, rate_hz: float | None = None,
    sensors: Sequence[str] = (),
) -> str:  # fmt: skip
    """The configuration; raises UsageError for a driver that has no example to begin with."""
    if driver not in _drivers():
        near = _ALSO_CALLED.get(driver) or nearest(driver, _drivers())
        raise UsageError(
            f"no driver {driver!r} to begin with; {f'did you mean {near}? ' if near else ''}"
            f"there are {', '.join(_drivers())}"
        )
    simulated = driver == "simulated"
    bus_hz = rate_hz or _RATE_HZ.get(driver, 1000)
    loop_hz = rate_hz or _FULL_RATE_HZ if driver in _IN_THE_LOOP else max(_BUS_LOOP_HZ, rate_hz or 0)
    filled = {
        "axes": ", ".join(axes),
        "rate": f"{bus_hz:g}",
        "watchdog_ms": f"{max(20.0, 4e3 / bus_hz):.0f}",
        **_where(driver, _LOCAL.get(driver, _ADDRESS) if address is None else address),
    }
    template = (shipped("config") / "new" / f"{driver}.yaml").read_text(encoding="utf-8")
    lines = [
        "schema_version: 2           # untuned: `micromanip check` asks for what is missing, `commission` tunes it",
        f"loop: {{rate_hz: {loop_hz:g}, limits: {'simulation' if simulated else 'hardware'}}}",
    ]
    counted_lines = itertools.count()

    def number(found: re.Match[str], i: int) -> str:
        first, step, of = found.groups()
        return str(int(first or 0) + int(step or 1) * (i if of == "i" else next(counted_lines)))

    for line in template.splitlines():
        if sensor := _SENSOR.match(line):
            if sensor[1] not in sensors:
                continue
            line = line[sensor.end() :]
        repeated = "{axis}" in line
        for i, axis in enumerate(axes if repeated else axes[:1]):
            counted = _COUNTED.sub(partial(number, i=i), line)
            lines.append(counted.format(axis=axis, **filled))
    lines.append("reference: {source: jog, offset_um: 0, range_um: [-10, 10]}     # volts, as long as it is untuned")
    lines.append("axes:")
    for axis in axes:
        lines.append(f"  {axis}:")
        lines += (
            ["    centre_um: 66", "    setpoint: {range_um: [2, 128], slew_um_per_ms: 20}"]
            if simulated
            else ["    setpoint: {}          # range_um of the gauge that the actuator reaches, slew_um_per_ms"]
        )
    return "\n".join(lines) + "\n"


def _where(driver: str, address: str) -> dict[str, str]:
    """What the address is in a driver's section: a path is a serial port."""
    is_port = address.startswith("/")
    host, has_port, port = address.partition(":")
    if not host or (has_port and not port.isdecimal()):
        raise UsageError(f"--address {address!r}: it takes a host such as 10.0.0.7 or 10.0.0.7:502, or a port's path")
    port = port or str(_PORTS.get(driver, 0))
    return {
        "address": address,
        "host": host,
        "port": port,
        "interface": "slcan" if is_port else "socketcan",
        "link": f"serial: {{device: {address}, baud: 115200}}" if is_port else f"tcp: {{host: {host}, port: {port}}}",
    }


def _drivers() -> list[str]:
    return sorted(file.stem for file in (shipped("config") / "new").glob("*.yaml"))


def _names(axes: str) -> list[str]:
    names = [name.strip() for name in axes.split(",")]
    if wrong := [name for name in names if not re.fullmatch(r"[a-z][a-z0-9_]*", name)]:
        raise UsageError(f"--axes {axes}: {wrong[0]!r} is no name of an axis; such as x,y,z")
    if len(set(names)) < len(names):
        raise UsageError(f"--axes {axes}: a name is there twice")
    return names
