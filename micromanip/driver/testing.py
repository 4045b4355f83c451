"""A cyclic driver in virtual time, for its author's tests."""

from __future__ import annotations

from pathlib import Path

from micromanip.bus.cyclic import call_context
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell


def virtual_cell(file: Path) -> VirtualCell:
    """The cell of a configuration, in virtual time: the loop's own code calls the drivers, without waiting.

    Raises ConfigError, with file and line, as `micromanip check` does.
    """
    prepared = prepare(file)
    return VirtualCell(prepared.parameters, prepared.wiring, prepared.samples)
