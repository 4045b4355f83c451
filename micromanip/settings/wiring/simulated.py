"""Devices that are called simulated, and aren't: what stands behind their names is looked at."""

from __future__ import annotations

from collections.abc import Iterator

from micromanip.settings.text.place import Finding

from .places import Wiring


def simulated_findings(wiring: Wiring) -> Iterator[Finding]:
    """Drivers with wide limits, no watchdog and perhaps nobody asked, whose device may move something real.

    What is not there yet (a link that simulate-device is going to make) can't be judged: look again once it is up.
    """
    for name, driver in wiring.drivers.items():
        if driver.simulated and (why := driver.real_because):
            yield (
                ("drivers", name, "simulated"),
                f"{why}: it may move a real stage; take simulated away, and set loop.limits: hardware",
            )
