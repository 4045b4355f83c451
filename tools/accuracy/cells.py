"""The cells that the figures are of: ours, and drawn plants, commissioned from factory values."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from micromanip.design.commission.cell import CommissionedCell, commission_cell
from micromanip.design.commission.knobs import Knobs
from micromanip.design.experiment import with_axis
from micromanip.settings.check import Prepared, prepare
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.model import Configuration
from micromanip.virtual.experiment import VirtualExperiment
from tools.robustness.campaign import narrowed
from tools.robustness.family import drawn_cell

ROOT = Path(__file__).resolve().parents[2]
AXIS, SEED, FIRST_PLANT, SLEW_UM_PER_MS = "x", 1, 200, 10.0
"""Axis of the drawn plants; seeds of the excitations and of the first plant; the slew limit of their set-point, as in
the cell of `make robustness`."""


def changed(name: str, axes: Sequence[str], noise_um: float | None = None) -> Prepared:
    """A configuration of ours with `axes` alone, which knows the truth and cuts; `noise_um`: the tracker's."""
    document = yaml.safe_load((ROOT / "config" / name).read_text(encoding="utf-8"))
    known = ("strain", "stage", "deviation", "true_strain", "true_stage", "path_error", "uncompensated")
    document["signals"] = {
        f"{kind}_{axis}": document["signals"].get(f"{kind}_{axis}", {"driver": "cell"})
        for kind in known
        for axis in axes
    }
    for section in ("outputs", "axes"):
        document[section] = {k: v for k, v in document[section].items() if k.removeprefix("voltage_") in axes}
    if "axes" in document["reference"]:
        document["reference"]["axes"] = {k: v for k, v in document["reference"]["axes"].items() if k in axes}
    cell = document["drivers"]["cell"]
    cell["axes"], cell["variation"] = list(axes), {k: v for k, v in cell["variation"].items() if k in axes}
    if noise_um is not None:
        cell["tracker"] = cell.get("tracker", {}) | {"noise_um": noise_um}
    return prepared_of(document, name)


def prepared_of(document: Mapping[str, Any], name: str) -> Prepared:
    """`document`, checked as the file `name`."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / name
        file.write_text(yaml.safe_dump(document), encoding="utf-8")
        return prepare(file)


def tuned(prepared: Prepared, configuration: Configuration) -> Prepared:
    """The same cell with another configuration."""
    return replace(prepared, configuration=configuration, parameters=compile_cell(configuration, prepared.wiring))


def commissioned(prepared: Prepared, configuration: Configuration) -> CommissionedCell:
    """`configuration` commissioned on the cell of `prepared`, the process going on where it rests."""
    experiment, running = VirtualExperiment(prepared), VirtualExperiment(prepared, process=True)
    return commission_cell(configuration, experiment, list(configuration.axes), lambda _: None, Knobs(), SEED, running)


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
