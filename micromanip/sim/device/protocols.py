"""Who plays the devices of which driver: one builder for each."""

from __future__ import annotations

from micromanip.io.contract import CyclicDriver
from micromanip.io.registry import driver_class

from .canbus import play_canbus
from .played import Builder, PlayedDevice, Surroundings

BUILDERS: dict[str, Builder] = {"canbus": play_canbus}
"""By the driver's entry point."""


def play_all(surroundings: Surroundings) -> dict[str, PlayedDevice]:
    """The devices of all drivers that speak on a bus, by the driver's name in the configuration.

    Raises ConfigError for a driver that nobody can play the device of, and where there is none to play.
    """
    source = surroundings.source
    devices: dict[str, PlayedDevice] = {}
    try:
        for name, entry in surroundings.configuration.drivers.items():
            if entry.driver in BUILDERS:
                devices[name] = BUILDERS[entry.driver](name, surroundings)
            elif not _is_cyclic(entry.driver):
                raise source.error(("drivers", name, "driver"), f"nothing plays a device for it; {_known()}")
        if not devices:
            raise source.error(("drivers",), f"none of them has a device to play; {_known()}")
    except BaseException:
        for device in devices.values():
            device.close()
        raise
    return devices


def _is_cyclic(driver: str) -> bool:
    """Such a one talks to no bus: what it needs is in the loop."""
    return issubclass(driver_class(driver), CyclicDriver)


def _known() -> str:
    return f"devices are played for {', '.join(BUILDERS)}"
