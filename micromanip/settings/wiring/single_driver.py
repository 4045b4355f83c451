"""One driver out of a configuration, whatever else is wrong in the file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from micromanip.bus.cyclic import CyclicDriver
from micromanip.bus.driver import Answer, BusDriver
from micromanip.bus.registry import driver_class
from micromanip.errors import ConfigError, UsageError, did_you_mean
from micromanip.settings.load import validate_section
from micromanip.settings.schema.model import Driver
from micromanip.settings.text.source import Source

from .places import kind_of

_PERIOD_NS = 100_000
"""Of a cyclic driver that no loop is going to call."""


def driver_to_probe(file: Path, name: str) -> BusDriver | CyclicDriver:
    """The driver that the configuration calls `name`, not opened.

    Reads its entry in the section drivers only. Raises ConfigError, and UsageError where the file has no such driver or
    it is one that has nothing to look at.
    """
    source = Source.read(file)
    entries = source.data.get("drivers") if isinstance(source.data, Mapping) else None
    if not isinstance(entries, Mapping):
        raise source.error(("drivers",), "this section is missing, or not a mapping")
    if name not in entries:
        raise UsageError(f"{file} has no driver called {name}; {did_you_mean(name, entries)}")
    entry = validate_section(source, ("drivers", name), Driver, entries[name])
    kind = kind_of(source, ("drivers", name), entry)
    if issubclass(kind, CyclicDriver) and kind.probe is CyclicDriver.probe:
        raise UsageError(
            f"{name} is the cyclic driver {entry.driver}: it has no bus to look at; `micromanip run` and `status` show "
            "its signals"
        )
    options = validate_section(source, ("drivers", name), kind.Options, entry.options)
    try:
        return kind(options, file.parent) if issubclass(kind, BusDriver) else kind(options, _PERIOD_NS)
    except ConfigError as problem:
        raise source.error_below(("drivers", name), str(problem)) from problem


def discovered(section: Mapping[str, Any], seconds: float) -> tuple[str, Iterator[Answer]]:
    """The device, and what answers where a section leads whose other keys are an example. Raises UsageError."""
    kind = driver_class(section["driver"])
    if issubclass(kind, BusDriver):
        return kind.discover(section, seconds)
    if kind.probe is CyclicDriver.probe:
        raise UsageError(f"the driver {section['driver']} has no bus to look at")
    # it must have a watchdog, whatever that is: nothing moves
    options = {**section, "watchdog": {"ms": 100, "rest_ms": 250, "after_power_on": "rest"}}
    driver = kind(kind.Options.model_validate({key: options[key] for key in options if key != "driver"}), _PERIOD_NS)
    return driver.device or section["driver"], driver.probe(seconds)
