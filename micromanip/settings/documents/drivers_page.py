"""The options of the drivers that come with the program, in Markdown, generated from their models.

``python -m micromanip.settings.documents.drivers_page > docs/driver-options.md`` writes it; a test compares the two.
"""

from __future__ import annotations

import sys

from micromanip.bus.driver import BusOptions
from micromanip.bus.registry import driver_class, inspected
from micromanip.settings.text.shape import Shape

from .configuration_page import Section, page, sections

_PACKAGE = "micromanip"
_INTRODUCTION = """\
# Options of the drivers

Generated from the drivers' models by `make docs`; edit the descriptions there.

The options of a driver stand in its section of the configuration, beside `driver:`. [Buses](buses.md) says which driver
serves which device. The [configuration reference](configuration.md) explains the notation of names, units and `null`.
"""


def render() -> str:
    """The whole page."""
    names = sorted(driver.name for driver in inspected() if driver.package == _PACKAGE)
    common, written = Shape.of(BusOptions), dict[tuple[str, ...], str]()
    parts: list[Section] = [("## Every driver", common, ())]
    for name in names:
        shape = Shape.of(driver_class(name).Options)
        parts.append((f"## `driver: {name}`\n\n{shape.description}", shape, common.fields))
        parts += sections(shape, f"{name}.", written)
    return page(_INTRODUCTION, parts)


if __name__ == "__main__":
    sys.stdout.write(render())
