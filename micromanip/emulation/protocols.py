"""Who plays the devices of which driver: one builder for each."""

from __future__ import annotations

from micromanip.bus.cyclic import CyclicDriver
from micromanip.bus.registry import driver_class
from micromanip.emulation.can.canbus import play_canbus
from micromanip.emulation.can.canopen import play_canopen
from micromanip.emulation.line.device_of_a_line import play_line
from micromanip.emulation.modbus.units_on_a_port import play_modbus

from .emulated import Builder, PlayedDevice, Surroundings

BUILDERS: dict[str, Builder] = {
    "canbus": play_canbus,
    "canopen": play_canopen,
    "line": play_line,
    "modbus": play_modbus,
}
"""By the driver's entry point."""


def play_all(surroundings: Surroundings) -> dict[str, PlayedDevice]:
    """The devices of all drivers that speak on a bus, by the driver's name in the configuration.

    Raises ConfigError for a driver that nobody can play the device of, and where there is none to play.
    """
    devices: dict[str, PlayedDevice] = {}
    try:
        for name, build in _builders(surroundings).items():
            devices[name] = build(name, surroundings)
    except BaseException:
        for device in devices.values():
            device.close()
        raise
    return devices


def _builders(surroundings: Surroundings) -> dict[str, Builder]:
    source, builders = surroundings.source, {}
    for name, entry in surroundings.configuration.drivers.items():
        if entry.driver in BUILDERS:
            builders[name] = BUILDERS[entry.driver]
        elif not _is_cyclic(entry.driver):
            raise source.error(("drivers", name, "driver"), f"nothing plays a device for it; {_known()}")
    if not builders:
        raise source.error(("drivers",), f"none of them has a device to play; {_known()}")
    return builders


def _is_cyclic(driver: str) -> bool:
    """Such a one talks to no bus: what it needs is in the loop."""
    return issubclass(driver_class(driver), CyclicDriver)


def _known() -> str:
    return f"devices are played for {', '.join(BUILDERS)}"
