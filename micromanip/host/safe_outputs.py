"""Outputs to their safe value while no controller runs: after a crash, by hand or by the service manager."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from micromanip.errors import CheckFailed, DeviceUnavailable
from micromanip.io.bridge import BusBridge
from micromanip.io.bus import Inbox
from micromanip.io.bus_errors import BusError
from micromanip.io.contract import CyclicDriver
from micromanip.io.device_lock import DeviceLocks
from micromanip.rt.intrinsics import call_context
from micromanip.settings.load import validate_section
from micromanip.settings.model import Driver, Loop
from micromanip.settings.source import Source
from micromanip.settings.wiring import build_driver


def drivers_of(file: Path) -> dict[str, CyclicDriver]:
    """The drivers of a configuration by name; raises ConfigError.

    Reads the sections loop and drivers only: what else is wrong in the file keeps no output from its safe value.
    """
    source = Source.read(file)
    data = source.data if isinstance(source.data, Mapping) else {}
    for section in ("loop", "drivers"):
        if not isinstance(data.get(section), Mapping):
            raise source.error((section,), "this section is missing, or not a mapping")
    period_ns = validate_section(source, ("loop",), Loop, data["loop"]).period_ns
    entries = {
        str(name): validate_section(source, ("drivers", name), Driver, entry) for name, entry in data["drivers"].items()
    }
    drivers = {name: build_driver(source, name, entry, period_ns, silent_ns=0)[0] for name, entry in entries.items()}
    outputs = data.get("outputs")
    for name, driver in drivers.items():
        if isinstance(driver, BusBridge):
            driver.rest = _rest(driver, name, outputs if isinstance(outputs, Mapping) else {})
    return drivers


def _rest(bridge: BusBridge, name: str, outputs: Mapping[Any, Any]) -> tuple[float, ...]:
    """Park voltage of each output as far as it can be read, else the driver's own safe value."""
    rest = [channel.safe for channel in bridge.bus.outputs]
    for key, entry in outputs.items():
        if isinstance(entry, Mapping) and entry.get("driver") == name:
            park_V, channel = entry.get("park_V"), entry.get("channel", key)
            if isinstance(park_V, int | float) and channel in bridge.outputs:
                rest[bridge.outputs.index(channel)] = float(park_V)
    return tuple(rest)


def make_safe(drivers: Mapping[str, CyclicDriver], wait_s: float = 0.0) -> list[str]:
    """Open each driver, bring its outputs to their safe value, close it again; does no harm twice.

    Waits up to `wait_s` for a controller that is ramping down. Every driver is tried; returns what could not be done,
    a line each. Raises CheckFailed where a controller still has one of the devices.
    """
    devices = {driver.device for driver in drivers.values() if driver.device is not None}
    try:
        locks = DeviceLocks(devices, wait_s=wait_s)
    except DeviceUnavailable as problem:
        raise CheckFailed(f"nothing was touched: {problem}") from problem
    with locks:
        outcomes = [_make_safe(name, driver) for name, driver in drivers.items()]
    return [outcome for outcome in outcomes if outcome is not None]


def _make_safe(name: str, driver: CyclicDriver) -> str | None:
    if isinstance(driver, BusBridge):
        return _rest_bus(name, driver)
    functions, context = driver.functions(), driver.context()
    at = context.ctypes.data
    if code := call_context(functions.open, at):
        return f"driver {name} could not be opened: code {code}"
    unsafe = call_context(functions.safe, at)
    unclosed = call_context(functions.close, at)
    if unsafe:
        return f"driver {name}: its outputs could not be made safe, code {unsafe}"
    return f"driver {name} could not be closed: code {unclosed}" if unclosed else None


def _rest_bus(name: str, bridge: BusBridge) -> str | None:
    """Give the devices of a bus their safe values, without a worker."""
    bus = bridge.bus
    try:
        bus.open()
        for number, task in enumerate(bus.tasks):
            if task.outputs:
                bus.perform(number, bridge.rest, Inbox())
    except BusError as problem:
        return f"driver {name}: its outputs could not be made safe: {problem}"
    finally:
        bus.close()
    return None
