"""Which signal of the plant stands behind each channel of a driver, by the names of the configuration."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass

from micromanip.settings.schema.model import Configuration, Output, Switch
from micromanip.settings.text.source import Source

from .cell import PlayedCell


@dataclass(frozen=True)
class Wires:
    """Of one driver: channel of the driver to name in the configuration, and the voltages at rest by that name."""

    signals: dict[str, str]
    outputs: dict[str, str]
    rest_V: dict[str, float]


def wires_of(driver: str, configuration: Configuration, source: Source, cell: PlayedCell) -> Wires:
    """What the configuration connects to `driver`; ConfigError with file and line for what the plant doesn't have."""
    signals = {entry.channel or name: name for name, entry in configuration.signals.items() if entry.driver == driver}
    for name in signals.values():
        if not cell.has(name):
            raise source.error(("signals", name), _missing(name, cell.plant.inputs))
    written: dict[str, tuple[str, Output | Switch]] = {
        name: ("outputs", output) for name, output in configuration.outputs.items()
    }
    for name in type(configuration.switches).model_fields:
        switch = getattr(configuration.switches, name)
        if switch is not None:
            written[name] = ("switches", switch)
    outputs = {}
    for name, (section, entry) in written.items():
        if entry.driver == driver:
            if name not in cell.plant.outputs:
                raise source.error((section, name), _missing(name, cell.plant.outputs))
            outputs[entry.channel or name] = name
    rest_V = {name: output.park_V for name, output in configuration.outputs.items() if output.driver == driver}
    return Wires(signals, outputs, rest_V)


def _missing(name: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    hint = f"did you mean {near[0]}?" if near else "digital lines exist with `simulation: {lines: {}}`"
    return f"the simulated plant has no {name}, which the devices are to play; {hint}"
