"""From a recording, or a run, to the memories of its axes: what belongs to which memory, and what may not."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import TOOL
from micromanip.settings.commissioned import tuning_hash
from micromanip.settings.load import validate_document
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker
from micromanip.settings.text.source import Source

from ..budget.loop import AxisLaws
from .law import Update, updated
from .memory import Learned, Memory, cell_name, memory_file, read_memory, write_memory
from .part import Part, Run
from .recognised import found_at
from .transfer import Transfer


def way_of(configuration: Configuration, name: str) -> Transfer:
    """From a correction to the stage of axis `name`. CheckFailed where its laws don't allow of one."""
    tracker, axis = configuration.reference, configuration.axes[name]
    if not isinstance(tracker, Tracker):
        raise CheckFailed(
            f"only what follows a tracker learns: reference.source is {tracker.source}, it must be signal"
        )
    if axis.authority_percent != 100.0:
        raise CheckFailed(f"axis {name}: authority_percent is {axis.authority_percent:g}: it learns with 100 only")
    return Transfer(AxisLaws(name, axis, tracker.of(name), configuration.loop.period_ns * 1e-9))


def begun(
    configuration: Configuration, name: str, part: Part, begin_s: float, tool: int = 0,
    temperature_C: float | None = None, *, repeats: bool = False,
) -> Memory:  # fmt: skip
    """A memory that knows its part only, and how it was made."""
    return Memory(
        cell_name(configuration), name, tuning_hash(configuration.axes[name]), part.rate_hz, begin_s, part.path_um,
        Learned.nothing(len(part.path_um)), tool=tool, temperature_C=temperature_C, repeats=repeats,
    )  # fmt: skip


class Learner:
    """Updates the memories in `folder` from recordings; the model of an axis is worked out once."""

    def __init__(self, folder: Path, limit_um: float, search_s: float, tolerance_um: float | None) -> None:
        """Limits of correction, search and path are those of `updated` and `found_at`."""
        self.folder, self._limit_um, self._search_s, self._tolerance_um = folder, limit_um, search_s, tolerance_um
        self._ways: dict[tuple[str, str], Transfer] = {}

    def update(
        self, telemetry: Telemetry, axes: Sequence[str], begin_s: float | None, seconds: float | None,
        say: Callable[[str], None],
    ) -> dict[str, Update]:  # fmt: skip
        """What each of `axes` makes of the recording; nothing is written. CheckFailed where one can't learn from it.

        A first part begins `begin_s` after tracking has, and takes `seconds`.
        """
        configuration = validate_document(Source.parse(telemetry.file, telemetry.sure_configuration()))
        found = {}
        for name in axes:
            say(f"{telemetry.file}: axis {name}")
            what, tool = str(telemetry.file), _tool_of(telemetry)
            file = memory_file(self.folder, name, tool)
            tuning, memory = tuning_hash(configuration.axes[name]), read_memory(file)
            way = self._ways.setdefault((name, tuning), way_of(configuration, name))
            if memory is not None:
                memory.require(cell_name(configuration), name, tuning, str(file))
            run = self._run(telemetry, configuration, name)
            part, memory = self._part(run, configuration, memory, way, begin_s, seconds, tool)
            found[name] = updated(memory, part, way, self._limit_um, what)
        return found

    def write(self, found: Mapping[str, Update]) -> None:
        """Put what the axes know after an update into their files. Raises OSError where it can't be."""
        for name, update in found.items():
            write_memory(memory_file(self.folder, name, update.memory.tool), update.memory)

    def _part(
        self, run: Run, configuration: Configuration, memory: Memory | None, way: Transfer, begin_s: float | None,
        seconds: float | None, tool: int,
    ) -> tuple[Part, Memory]:  # fmt: skip
        if memory is None:
            if begin_s is None or seconds is None:
                raise CheckFailed(
                    f"{run.what}: there is no memory of axis {way.laws.name} yet: say when the part begins and how "
                    "long it takes (--begin, --seconds)"
                )
            part = run.part(begin_s, seconds)
            return part, begun(configuration, way.laws.name, part, begin_s, tool)
        about_s = memory.begin_s if begin_s is None else begin_s
        at_s = found_at(memory, run, about_s, self._search_s, self._tolerance_um)
        return run.part(at_s, memory.seconds), memory

    @staticmethod
    def _run(telemetry: Telemetry, configuration: Configuration, name: str) -> Run:
        place = telemetry.axes.index(name)

        def axis(column: str) -> NDArray[Any]:
            return telemetry.column(f"axis.{place}.{column}")

        range_V = configuration.outputs[f"voltage_{name}"].range_V
        return Run.of(str(telemetry.file), telemetry.column, axis, telemetry.period_ns * 1e-9, range_V)


def _tool_of(telemetry: Telemetry) -> int:
    """Number of the tool while it tracked, 0 where none was told. CheckFailed where it was changed meanwhile."""
    tools = np.unique(telemetry.column("lines")[telemetry.column("state") == TRACKING].astype(int) >> TOOL)
    if len(tools) > 1:
        numbers = ", ".join(map(str, tools))
        raise CheckFailed(f"{telemetry.file}: the tool was changed in it ({numbers}): cut it into one part for each")
    return int(tools[0]) if len(tools) else 0
