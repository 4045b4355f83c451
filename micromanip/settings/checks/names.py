"""Names that must match: signals and outputs with the axes that take them, and with the tracker's frame."""

from __future__ import annotations

from collections.abc import Iterator

from micromanip.errors import nearest
from micromanip.settings.schema.frame import PREFIX
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Jog, Tracker
from micromanip.settings.text.place import Finding

_ROLES = (
    *("strain", "stage", "deviation", "acceleration", "true_strain", "true_stage", "path_error", "uncompensated"),
    *("amplifier_ok", "temperature_ok"),
)
_LINES = ("enable", "interlock", "retracted", "part", "tool", "temperature")


def name_findings(configuration: Configuration) -> Iterator[Finding]:
    """Signals and outputs that nobody takes, and those that an axis or the frame lacks."""
    known = [*_LINES, *(f"{role}_{axis}" for axis in configuration.axes for role in _ROLES)]
    frame = configuration.frame
    for name in configuration.signals:
        if name not in known and not name.startswith(PREFIX):
            hint = f"; did you mean {near}?" if (near := nearest(name, known)) else ""
            yield (
                ("signals", name),
                f"no axis takes a signal of this name{hint} (names are <role>_<axis>, {', '.join(_LINES)})",
            )
    for name, signal in configuration.signals.items():
        if signal.range_um is not None and not name.startswith(("strain_", "stage_")):
            yield ("signals", name, "range_um"), "only strain and stage signals have a range: nobody would look at it"
    for name in configuration.outputs:
        if name not in {f"voltage_{axis}" for axis in configuration.axes}:
            yield (
                ("outputs", name),
                f"no axis has this output; outputs are named voltage_<axis> ({', '.join(configuration.axes)})",
            )
    if isinstance(configuration.reference, Jog):
        for name in configuration.reference.target_um:
            if name not in configuration.axes:
                yield ("reference", "target_um", name), f"no such axis; axes are {', '.join(configuration.axes)}"
    follows = isinstance(configuration.reference, Tracker)
    for name, axis in configuration.axes.items():
        wanted = ["strain"] if axis.mode != "voltage" else []
        wanted += ["stage"] if axis.mode == "stage" else []
        wanted += ["deviation"] if follows and frame is None else []
        for role in wanted:
            if f"{role}_{name}" not in configuration.signals:
                yield (
                    ("axes", name),
                    f"mode {axis.mode} needs the signal {role}_{name}, which the section signals does not have",
                )
        if f"voltage_{name}" not in configuration.outputs:
            yield ("axes", name), f"there is no output voltage_{name}; add it to the section outputs"
        if follows and axis.mode == "voltage":
            yield ("axes", name, "mode"), "a voltage can't follow the source signal; use mode strain or stage"
    yield from _frame(configuration)


def coupling_findings(configuration: Configuration) -> Iterator[Finding]:
    """Sections ``coupling`` that speak of axes that are not there, or of what can't be decoupled."""
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


def _frame(configuration: Configuration) -> Iterator[Finding]:
    """A frame whose signals or axes are not those of the configuration; coordinates that nobody uses."""
    frame = configuration.frame
    used = () if frame is None else frame.sources
    for name in configuration.signals:
        if name.startswith(PREFIX) and name not in used:
            yield ("signals", name), "no frame uses it; name it in reference.frame.signals"
    if frame is None:
        return
    for name in used:
        if name not in configuration.signals:
            section = ("signals",) if name in frame.signals else ("lever", "signals")
            yield ("reference", "frame", *section), f"the section signals has no {name}"
    if len(frame.matrix) != len(configuration.axes):
        yield (
            ("reference", "frame", "matrix"),
            f"{len(frame.matrix)} rows for {len(configuration.axes)} axes ({', '.join(configuration.axes)})",
        )
    for name in configuration.axes:
        if f"deviation_{name}" in configuration.signals:
            yield ("signals", f"deviation_{name}"), "reference.frame computes it already; one of the two must go"
