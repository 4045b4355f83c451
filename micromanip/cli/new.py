"""``micromanip new``: a small configuration to begin one's own cell with, untuned."""

from __future__ import annotations

import re
from collections.abc import Sequence

import click

from micromanip.errors import UsageError, nearest
from micromanip.shipped import shipped

from .echo import echo
from .options import StrictCommand, emit_json, json_option

_LOCAL = {"canbus": "can0", "canopen": "can0", "ethercat": "eth1"}
"""Where a driver's address is an interface of this machine; the others have one in the network."""
_ADDRESS = "192.168.0.10"
_RATE_HZ = {"simulated": 10_000, "udp": 10_000, "ethercat": 10_000}
_BUS_RATE_HZ = 2000
_COUNTED = re.compile(r"\{(?:(\d+)\+)?(\d*)i\}")
"""A number that grows with the axis: ``{100+2i}`` is 100, 102, 104."""


@click.command(
    "new", cls=StrictCommand, epilog="Example: micromanip new --driver modbus --axes z --address 10.0.0.7 > cell.yaml"
)
@click.option("--driver", metavar="NAME", help="Driver of the device; --list shows them.")
@click.option("--axes", default="x", show_default=True, metavar="X,Y", help="Names of the axes.")
@click.option("--address", metavar="WHERE", help="Host, or interface of this machine, of the device.")
@click.option("--list", "lists", is_flag=True, help="Show the drivers and the examples that come with the program.")
@json_option
def command(driver: str | None, axes: str, address: str | None, lists: bool, as_json: bool) -> None:
    """Print a small configuration of your own cell, untuned.

    Registers, messages and channels in it are an example: put those of the device's manual in their place. What only
    you can know is left out, and `check` asks for it: ranges, slew limits, working point. Then `device probe`,
    and `commission`.
    """
    examples = [str(file) for file in sorted(shipped("config").glob("*.yaml"))]
    if lists and as_json:
        emit_json({"drivers": _drivers(), "examples": examples})
        return
    if lists:
        echo(f"drivers: {', '.join(_drivers())}")
        echo("examples, tuned, each beside `micromanip device simulate`:")
        for file in examples:
            echo(f"  {file}")
        return
    if driver is None:
        raise UsageError(f"--driver is missing: one of {', '.join(_drivers())}")
    text = text_for(driver, _names(axes), address)
    if as_json:
        emit_json({"configuration": text})
    else:
        echo(text.rstrip("\n"))


def text_for(driver: str, axes: Sequence[str], address: str | None = None) -> str:
    """The configuration; raises UsageError for a driver that has no example to begin with."""
    if driver not in _drivers():
        near = nearest(driver, _drivers())
        raise UsageError(
            f"no driver {driver!r} to begin with{f'; did you mean {near}?' if near else ''} "
            f"There are {', '.join(_drivers())}"
        )
    simulated = driver == "simulated"
    where = address or _LOCAL.get(driver, _ADDRESS)
    template = (shipped("config") / "new" / f"{driver}.yaml").read_text(encoding="utf-8")
    lines = [
        "schema_version: 2           # untuned: `micromanip check` asks for what is missing, `commission` tunes it",
        f"loop: {{rate_hz: {_RATE_HZ.get(driver, _BUS_RATE_HZ)}, limits: {'simulation' if simulated else 'hardware'}}}",
    ]
    for line in template.splitlines():
        repeated = "{axis}" in line
        for i, axis in enumerate(axes if repeated else axes[:1]):
            counted = _COUNTED.sub(lambda found, i=i: _number(found, i), line)  # type: ignore[misc]
            lines.append(counted.format(axis=axis, axes=", ".join(axes), address=where))
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


def _number(found: re.Match[str], i: int) -> str:
    first, step = found.groups()
    return str(int(first or 0) + int(step or 1) * i)


def _drivers() -> list[str]:
    return sorted(file.stem for file in (shipped("config") / "new").glob("*.yaml"))


def _names(axes: str) -> list[str]:
    names = [name.strip() for name in axes.split(",")]
    if wrong := [name for name in names if not re.fullmatch(r"[a-z][a-z0-9_]*", name)]:
        raise UsageError(f"--axes {axes}: {wrong[0]!r} is no name of an axis; such as x,y,z")
    if len(set(names)) < len(names):
        raise UsageError(f"--axes {axes}: a name is there twice")
    return names
