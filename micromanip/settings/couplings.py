"""Whether what the sections ``coupling`` say of the axes is there to be decoupled."""

from __future__ import annotations

from collections.abc import Iterator

from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.place import Finding


def coupling_findings(configuration: Configuration) -> Iterator[Finding]:
    """Axes that are not there, and what can't be decoupled."""
    for name, axis in configuration.axes.items():
        if axis.coupling is None:
            continue
        path: tuple[str | int, ...] = ("axes", name, "coupling")
        for other in axis.coupling.share:
            if other == name:
                yield (*path, "share", other), "an axis moves wholly with itself; leave it out"
            elif other not in configuration.axes:
                yield (*path, "share", other), f"there is no axis {other}; the axes are {', '.join(configuration.axes)}"
        if axis.coupling.decouple and axis.outer is None:
            yield (
                (*path, "decouple"),
                "needs the section outer, whose model says what moves this stage; commission the axis first",
            )
