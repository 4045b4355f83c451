"""Who emulates the devices of which driver: one builder for each."""

from __future__ import annotations

from micromanip.bus.cyclic import CyclicDriver
from micromanip.bus.registry import driver_class
from micromanip.emulation.can.canbus import emulate_canbus
from micromanip.emulation.can.canopen import emulate_canopen
from micromanip.emulation.line.device_of_a_line import emulate_line
from micromanip.emulation.modbus.units_on_a_port import emulate_modbus
from micromanip.emulation.udp.device import emulate_udp

from .emulated import Builder, EmulatedDevice, Surroundings

BUILDERS: dict[str, Builder] = {
    "canbus": emulate_canbus,
    "canopen": emulate_canopen,
    "line": emulate_line,
    "modbus": emulate_modbus,
    "udp": emulate_udp,
}
"""By the driver's entry point."""


def emulate_all(surroundings: Surroundings) -> dict[str, EmulatedDevice]:
    """The devices of all drivers that speak on a bus, by the driver's name in the configuration.

    Raises ConfigError for a driver whose device nobody can emulate, and where there is none to emulate.
    """
    devices: dict[str, EmulatedDevice] = {}
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
            raise source.error(("drivers", name, "driver"), f"nothing emulates a device for it; {_known()}")
    if not builders:
        raise source.error(("drivers",), f"none of them has a device to emulate; {_known()}")
    return builders


def _is_cyclic(driver: str) -> bool:
    """Such a one talks to no bus: what it needs is in the loop."""
    return issubclass(driver_class(driver), CyclicDriver)


def _known() -> str:
    return f"devices are emulated for {', '.join(BUILDERS)}"
