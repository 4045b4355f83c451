"""The house as it is: its rooms, how large they are, and who imports whom, counted from the sources."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import grimp
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import micromanip

ROOMS = (
    *("cli", "gateway", "learner", "driver", "client", "host", "design"),
    *("virtual", "emulation", "conformance", "replay", "settings", "control", "recordings", "testbus"),
    *("bus", "faults", "rt"),
)
"""From above to below: a room imports from those below it only."""
ANYWHERE = ("errors", "extras", "files", "quantities", "replies", "shipped", "status_reply")
"""What every room may import: counted with none."""


def room(module: str) -> str:
    """The room that a module of the program stands in."""
    return module.split(".")[1] if "." in module else ""


def house() -> Figure:
    """A matrix: how many modules of the room of a row import something from the room of a column."""
    graph = grimp.build_graph("micromanip", cache_dir=None)
    imports = Counter(
        (room(module), below)
        for module in graph.modules
        for below in {room(other) for other in graph.find_modules_directly_imported_by(module)}
        if room(module) != below
    )
    unknown = {name for module in graph.modules if (name := room(module)) and name not in (*ROOMS, *ANYWHERE)}
    assert not unknown, f"rooms without a place in the picture: {unknown}"
    package = Path(micromanip.__file__).parent
    figure = Figure(figsize=(8.8, 6.2), layout="constrained")
    panel = figure.subplots()
    for row, above in enumerate(ROOMS):
        files = [package / f"{above}.py"] if (package / f"{above}.py").exists() else [*(package / above).rglob("*.py")]
        lines = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)
        size = f"{len(files)} files, {round(lines, -2) or lines} lines" if len(files) > 1 else f"{lines} lines"
        panel.text(-0.8, row, f"{above}   ({size})", ha="right", va="center", fontsize=9)
        for column, below in enumerate(ROOMS):
            count = imports[above, below]
            colour = "#e8e8e8" if row == column else "#2b6cb0" if column > row else "#c53030"
            if count or row == column:
                strength = 1.0 if row == column else min(1.0, 0.25 + count / 40)
                panel.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, fc=colour, alpha=strength, ec="white"))
            if count:
                panel.text(column, row, str(count), ha="center", va="center", fontsize=8)
    panel.set_xticks(range(len(ROOMS)), ROOMS, rotation=60, ha="left", fontsize=9)
    panel.xaxis.tick_top()
    panel.set(xlim=(-0.5, len(ROOMS) - 0.5), ylim=(len(ROOMS) - 0.5, -0.5), yticks=[])
    panel.spines[:].set_visible(False)
    panel.tick_params(length=0)
    return figure
