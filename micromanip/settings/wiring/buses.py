"""What a bus must carry, names that mean the same wire, and whose clock is followed: judged before anything moves.

Also devices that are called simulated, and aren't.
"""

from __future__ import annotations

from collections.abc import Iterator

from micromanip.bus.device_identity import identities
from micromanip.bus.driver import Load
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.place import Finding

from .places import Wiring

_POSITIONS = ("strain_", "stage_", "deviation_", "tracker_")


def budget(wiring: Wiring) -> dict[str, list[Load]]:
    """Loads of each bus, or wire of the loop's own, by the name of its driver."""
    loads = {name: list(driver.loads()) for name, driver in wiring.drivers.items()}
    return {name: of_driver for name, of_driver in loads.items() if of_driver or name in wiring.buses}


def bus_findings(configuration: Configuration, wiring: Wiring) -> Iterator[Finding]:
    """Buses that are overloaded, devices with two drivers, positions that are read from the same channel."""
    for name, loads in budget(wiring).items():
        full = [load for load in loads if load.share > load.limit]
        if full:
            each = (
                f"{load.name} would be busy for {100 * load.share:.0f} % of the time ({load.detail})" for load in full
            )
            yield (
                ("drivers", name),
                f"{', '.join(each)}, at most {100 * full[0].limit:.0f} % can be relied on; lower a rate, pack signals "
                "into fewer messages, or use a faster bus",
            )
    yield from _shared_devices(wiring)
    yield from _two_clocks(wiring)
    sources: dict[int, str] = {}
    for name in configuration.signals:
        if not name.startswith(_POSITIONS) or configuration.signals[name].driver not in wiring.buses:
            continue  # a line may serve several axes; a cell in memory has no wire that could be counted
        first = sources.setdefault(wiring.signal(name), name)
        if first != name:
            yield ("signals", name), f"it reads the same channel as {first}"


def rest_findings(configuration: Configuration, wiring: Wiring) -> Iterator[Finding]:
    """Outputs that a cyclic driver by itself brings to another value than the loop parks them at.

    The loop would never be seen to ask for rest, and never be given the outputs back.
    """
    for name, entry in configuration.outputs.items():
        driver = wiring.drivers[entry.driver]
        rest = {channel.name: channel.safe for channel in driver.slow_outputs}.get(entry.channel or name)
        if entry.driver not in wiring.buses and rest is not None and rest != entry.park_V:
            yield (
                ("outputs", name, "park_V"),
                f"{entry.park_V:g} V, but driver {entry.driver} brings this channel to {rest:g} by itself (`safe`): "
                "give both the same value",
            )


def simulated_findings(wiring: Wiring) -> Iterator[Finding]:
    """Drivers with wide limits, no watchdog and perhaps nobody asked, whose device may move something real.

    What is not there yet (a link that device simulate is going to make) can't be judged: look again once it is up.
    """
    for name, driver in wiring.drivers.items():
        if driver.simulated and (why := driver.real_because):
            yield (
                ("drivers", name, "simulated"),
                f"{why}: it may move a real stage; take simulated away, and set loop.limits: hardware",
            )


def _two_clocks(wiring: Wiring) -> Iterator[Finding]:
    first, *others = [name for name, driver in wiring.drivers.items() if driver.steers] or [""]
    for name in others:
        yield ("drivers", name), f"the loop's deadlines follow the clock of driver {first} already; one can be followed"


def _shared_devices(wiring: Wiring) -> Iterator[Finding]:
    owners: dict[str, tuple[str, str]] = {}
    for name, driver in wiring.drivers.items():
        for device in driver.devices:
            known = identities(device)
            others = [owners[identity] for identity in known if identity in owners]
            if others:
                owner, called = min(others)
                here = "" if called == device else f", here called {device}"
                yield ("drivers", name), f"driver {owner} owns {called} already{here}; one driver has a device alone"
            owners |= {identity: (name, device) for identity in known if identity not in owners}
