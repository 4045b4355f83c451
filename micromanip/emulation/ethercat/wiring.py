"""Which numbers in the terminals' memories are which of the plant's signals and outputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from micromanip.bus.ethercat.process_data import PackedNumber, packed_numbers
from micromanip.bus.frame_plan import FramePlan, GroupPlan
from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.emulated import Wires
from micromanip.emulation.plant import fill_plant

from .line import Line
from .serving import COUNTS, NOBODYS


@dataclass(frozen=True)
class WiredTerminal:
    """A terminal's numbers, in the order of its PDOs."""

    outputs: list[str | None]
    """The plant's output of each, None where nothing is wired."""
    inputs: list[tuple[str, bool]]
    """The signal of each, and whether it counts that signal's samples instead of saying it."""


def wire(d: Any, line: Line, terminals: Mapping[str, Any], cell: EmulatedCell, wires: Wires) -> list[WiredTerminal]:
    """Fill the record `d` for compiled code; `terminals` are the options of each, in the order of `line`."""
    fill_plant(d, cell.plant)
    d["output"] = -1
    wired = []
    for k, keys in enumerate(terminals.values()):
        areas = line.applications[k].terminal
        outputs = _numbers(keys.outputs, areas.output_area.start)
        inputs = _numbers(keys.inputs, areas.input_area.start)
        terminal = WiredTerminal([wires.outputs.get(channel) for channel in outputs], list(_readings(keys, wires)))
        d["outputs"][k], d["inputs"][k] = _table(outputs), _table(inputs)
        d["output"][k][: len(outputs)] = [cell.plant.outputs.get(each or "", -1) for each in terminal.outputs]
        d["signal"][k][: len(inputs)] = [
            _index(cell.plant.inputs.get(name), counts) for name, counts in terminal.inputs
        ]
        wired.append(terminal)
    return wired


def _index(at: int | None, counts: bool) -> int:
    if at is None:
        return NOBODYS
    return COUNTS + at if counts else at


def _numbers(pdos: Mapping[str, Any], start: int) -> dict[str, PackedNumber]:
    """All of a direction, by field, where they lie in a terminal's memory."""
    return {name: each for _, numbers in packed_numbers(pdos, start) for name, each in numbers.items()}


def _table(placed: Mapping[str, PackedNumber]) -> Any:
    """The numbers of a terminal's outputs or inputs, for compiled code."""
    return FramePlan(0, [GroupPlan(placed)]).record()[0]


def _readings(keys: Any, wires: Wires) -> Iterator[tuple[str, bool]]:
    """For each number of a terminal's inputs the signal that it says, or whose samples it counts."""
    for pdo in keys.inputs.values():
        measured = next((name for name in pdo.fields if name != pdo.counter), "")
        for name in pdo.fields:
            counts = name == pdo.counter
            signal = measured if counts else name
            yield wires.signals.get(signal, signal), counts
