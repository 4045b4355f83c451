"""A commissioned cell as its file has it: the text, what that is read as, and where it comes from."""

from __future__ import annotations

import datetime
import getpass
import os
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from micromanip.settings.check import Prepared, wired
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.source import Source
from micromanip.settings.write import with_production, with_tuning


def tuned_text(prepared: Prepared, configuration: Configuration, axes: Mapping[str, Axis]) -> str:
    """The configuration file with the tuning of `axes`, in production as `configuration` has it."""
    return with_production(with_tuning(prepared.source.text, axes), configuration)


def as_written(prepared: Prepared, configuration: Configuration) -> Configuration:
    """What a file of `configuration` holds once it is read again; raises ConfigError where `check` would."""
    return wired(Source.parse(prepared.source.path, tuned_text(prepared, configuration, configuration.axes)))[0]


def provenance(prepared: Prepared, config: Path, chosen: list[str], seed: int) -> dict[str, str]:
    """Where a report comes from: simulated or hardware, which version, when, by whom, with which sensors."""
    drivers = {name: prepared.wiring.drivers[name] for name in prepared.configuration.drivers}
    devices = {name: driver.device or prepared.configuration.drivers[name].driver for name, driver in drivers.items()}
    sensors = {
        f"sensors of {axis}": ", ".join(
            f"{name} at {devices[entry.driver]}" + (f" ({entry.channel})" if entry.channel else "")
            for name in (f"strain_{axis}", f"stage_{axis}", f"deviation_{axis}")
            if (entry := prepared.configuration.signals.get(name)) is not None
        )
        for axis in chosen
    }
    return {
        "cell": f"hardware: {', '.join(devices[name] for name in prepared.wiring.real)}"
        if prepared.wiring.real
        else "simulated, nothing real moved",
        "configuration": f"{config} ({prepared.source.hash[:8]})",
        "time": f"{datetime.datetime.now(datetime.UTC):%Y-%m-%dT%H:%M:%SZ}",
        "operator": _logged_in(),
        "version": f"micromanip {version('micromanip')}",
        "rate": f"{prepared.configuration.loop.rate_hz:g} Hz",
        "seed": str(seed),
        **sensors,
    }


def _logged_in() -> str:
    try:
        return os.environ.get("SUDO_USER") or getpass.getuser()
    except (KeyError, OSError):  # a user without an entry, as in a container
        return f"user {os.getuid()}"
