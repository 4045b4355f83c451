"""The section `simulation`: the simulated cell that stands behind the devices that are played."""

from __future__ import annotations

from micromanip.bus.cyclic import CyclicDriver
from micromanip.bus.registry import driver_class
from micromanip.errors import ConfigError
from micromanip.settings.load import validate_section
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.source import Source

SECTION = ("simulation",)


def build_plant(configuration: Configuration, source: Source, period_ns: int, seed: int | None = None) -> CyclicDriver:
    """The driver that the section `simulation` describes, with its period; `seed` replaces its own.

    Raises ConfigError with file, line and key: also where there is no such section, or its driver moves a real stage.
    """
    section = configuration.simulation
    if section is None:
        raise source.error(
            (),
            "there is no section simulation, which says what plant stands behind the devices; "
            "write `simulation: {}` for one with all its defaults",
        )
    try:
        kind = driver_class(section.driver)
    except ConfigError as problem:
        raise source.error((*SECTION, "driver"), str(problem)) from problem
    if not (issubclass(kind, CyclicDriver) and kind.simulated):
        raise source.error((*SECTION, "driver"), f"{section.driver} moves a real stage; the plant must be a simulation")
    options = validate_section(source, SECTION, kind.Options, section.options)
    if seed is not None and "seed" in kind.Options.model_fields:
        options = options.model_copy(update={"seed": seed})
    try:
        return kind(options, period_ns)
    except ConfigError as problem:
        raise source.error(SECTION, str(problem)) from problem
