"""The options of the drivers that come with the program, in Markdown, generated from their models.

``python -m micromanip.settings.documents.drivers_page > docs/driver-options.md`` writes it; a test compares the two.
"""

from __future__ import annotations

import sys

from micromanip.bus.inspection import inspected
from micromanip.bus.registry import driver_class
from micromanip.settings.text.shape import Shape

from .configuration_page import section, sections

_PACKAGE = "micromanip"
_INTRODUCTION = """\
# Options of the drivers

Generated from the drivers' models by `make docs`; edit the descriptions there.

A driver's options stand in its own section of the configuration, beside `driver:`. Which driver for what is said in
[Field buses](fieldbus.md) and [Drivers](drivers.md); how names, units and `null` are to be read, in the
[configuration reference](configuration.md).
"""


def render() -> str:
    """The whole page."""
    names = sorted(driver.name for driver in inspected() if driver.package == _PACKAGE)
    parts = [_INTRODUCTION]
    for name in names:
        shape = Shape.of(driver_class(name).Options)
        parts += [section(f"drivers: driver {name}", shape), *sections(shape, f"driver {name}.")]
    return "\n".join(parts)


if __name__ == "__main__":
    sys.stdout.write(render())
