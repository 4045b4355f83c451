"""Simulated cells for experiments in virtual time: examples that were changed, and what commissioning makes of them."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from micromanip.design.commission.cell import CommissionedCell, commission_cell
from micromanip.design.commission.closing import Options
from micromanip.design.experiment import with_axis
from micromanip.settings.check import Prepared, prepare
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.model import Configuration
from micromanip.virtual.experiment import VirtualExperiment

from .drawn_plants import drawn_cell
from .report import ROOT
from .robustness import narrowed

AXIS, SEED, FIRST_PLANT, SLEW_UM_PER_MS = "x", 1, 200, 10.0
"""Axis of the drawn plants; seeds of the excitations and of the first plant; the slew limit of their set-point, as in
the cell of the campaign `robustness`."""


def changed(name: str, change: Callable[[Any], None]) -> Prepared:
    """The example `name` after `change` of its document."""
    document = yaml.safe_load((ROOT / "config" / name).read_text(encoding="utf-8"))
    change(document)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / name
        file.write_text(yaml.safe_dump(document), encoding="utf-8")
        return prepare(file)


def of_axes(name: str, axes: Sequence[str]) -> Prepared:
    """The example `name` with `axes` alone, which knows the truth and cuts."""

    def change(document: Any) -> None:
        known = ("strain", "stage", "deviation", "true_strain", "true_stage", "path_error", "uncompensated")
        signals = document["signals"]
        names = [f"{kind}_{axis}" for kind in known for axis in axes]
        document["signals"] = {each: signals.get(each, {"driver": "cell"}) for each in names}
        for section in ("outputs", "axes"):
            document[section] = {k: v for k, v in document[section].items() if k.removeprefix("voltage_") in axes}
        if "axes" in document["reference"]:
            document["reference"]["axes"] = {k: v for k, v in document["reference"]["axes"].items() if k in axes}
        cell = document["drivers"]["cell"]
        cell["axes"], cell["variation"] = list(axes), {k: v for k, v in cell["variation"].items() if k in axes}

    return changed(name, change)


def tuned(prepared: Prepared, configuration: Configuration) -> Prepared:
    """The same cell with another configuration."""
    return replace(prepared, configuration=configuration, parameters=compile_cell(configuration, prepared.wiring))


def commissioned(prepared: Prepared, configuration: Configuration) -> CommissionedCell:
    """`configuration` commissioned on the cell of `prepared`, the process going on where it rests."""
    experiment, running = VirtualExperiment(prepared), VirtualExperiment(prepared, process=True)
    return commission_cell(
        configuration, experiment, list(configuration.axes), lambda _: None, Options(), SEED, running
    )


def drawn(prepared: Prepared, seed: int) -> Prepared | str:
    """The plant of `seed`, commissioned; a reason where it isn't."""
    cell, _, reach = drawn_cell(prepared, AXIS, seed)
    narrow = narrowed(prepared.configuration, reach)
    setpoint = narrow.axes[AXIS].setpoint.model_copy(update={"slew_um_per_ms": SLEW_UM_PER_MS})
    found = commissioned(cell, with_axis(narrow, AXIS, setpoint=setpoint))
    if found.stopped is not None:
        return str(found.stopped)
    missed = [f"{each.name}: {each.value}" for story in found.evidence for each in story.criteria if not each.passed]
    return "; ".join(missed) if missed else tuned(cell, found.configuration)
