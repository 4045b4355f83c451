"""Finding drivers by entry point."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

from micromanip.errors import ConfigError, did_you_mean

from .cyclic import CyclicDriver
from .driver import BusDriver

GROUP = "micromanip.drivers"


def installed() -> dict[str, EntryPoint]:
    """All installed drivers by name."""
    return {point.name: point for point in entry_points(group=GROUP)}


def driver_class(name: str) -> type[CyclicDriver] | type[BusDriver]:
    """Class of the driver called `name`; raises ConfigError where it is not there, is none, or lacks a member."""
    points = installed()
    if name not in points:
        hint = did_you_mean(name, sorted(points), "installed are:")
        raise ConfigError(f"no driver called {name} is installed; {hint}")
    try:
        found = points[name].load()
    except (Exception, SystemExit) as problem:  # whatever the author's module does when it is imported
        why = problem if isinstance(problem, ImportError | AttributeError) else f"{type(problem).__name__}: {problem}"
        raise ConfigError(f"driver {name} can't be loaded from {points[name].value}: {why}") from problem
    if not (isinstance(found, type) and issubclass(found, CyclicDriver | BusDriver)):
        raise ConfigError(
            f"driver {name} ({points[name].value}) is neither a micromanip.driver.CyclicDriver "
            "nor a micromanip.driver.BusDriver"
        )
    if found.__abstractmethods__:
        raise ConfigError(
            f"driver {name} ({points[name].value}) does not have {', '.join(sorted(found.__abstractmethods__))}: "
            "every driver of its kind must; tell its author"
        )
    return found
