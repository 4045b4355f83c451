"""A recording of ours: what it is of, and its rows in parts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

from .file_header import CONFIGURATION
from .table import Array, Table

_MOST_VALUES = 250_000_000

Rows = Iterator[Mapping[str, NDArray[Any]]]
Parts = Callable[[Sequence[str]], Rows]
"""Columns by path, as ``cycle`` or ``axis.0.strain_um``, part by part from the first row on."""


Piece = Callable[[Sequence[str]], Mapping[str, NDArray[Any]]]
"""Some rows in a row, read when it is called: columns by path, without what is before them."""


@dataclass(frozen=True)
class Telemetry:
    """One run, or a piece of it.

    `dtype` is the row of the program that wrote it; `configuration` its text, of the hash `sha256`; `end` says how many
    ``rows`` are in it and how many were ``lost``, empty where it was not ended in order. `state` and `parameters` are
    records as the loop had them, `states` those on the way, `marks` the remarks. `pieces` finds all of the file's
    without reading their rows. `sources` tells the version of the cycle (`file_header.sources_of_cycle`); `samples`
    (n, axes) is what the source `file` played, None where nothing was. `damaged` names what stood beside the rows and
    can't be trusted: it is left out.
    """

    file: Path
    axes: list[str]
    period_ns: int
    dtype: np.dtype[Any]
    configuration: str
    sha256: str
    end: Mapping[str, int]
    parts: Parts = field(repr=False)
    rows: Callable[[], Iterator[NDArray[Any]]] = field(repr=False)
    pieces: Callable[[], list[Piece]] = field(repr=False)
    state: NDArray[Any] | None = field(default=None, repr=False)
    parameters: Sequence[NDArray[Any]] = field(default=(), repr=False)
    marks: Sequence[Mapping[str, Any]] = ()
    states: Sequence[NDArray[Any]] = field(default=(), repr=False)
    samples: NDArray[Any] | None = field(default=None, repr=False)
    sources: str = ""
    damaged: Sequence[str] = ()

    @classmethod
    def of_rows(cls, file: Path, axes: list[str], period_ns: int, rows: NDArray[Any], configuration: str) -> Telemetry:
        """Rows (n,) that are in memory, as if `file` held them; `configuration` is the text that they ran with."""

        def column(path: str) -> NDArray[Any]:
            of_axis, _, rest = path.partition(".")
            place, _, name = rest.partition(".")
            return np.asarray(rows[of_axis][name][:, int(place)] if rest else rows[path])

        return cls(
            file, axes, period_ns, rows.dtype, configuration, "", {},
            lambda paths: iter([{path: column(path) for path in paths}]), lambda: iter([rows]), list,
        )  # fmt: skip

    def sure_configuration(self) -> str:
        """Its text, for what can't be judged without. CheckFailed where it is damaged, or not there."""
        self.require_whole(CONFIGURATION)
        if not self.configuration.strip():
            raise CheckFailed(f"{self.file}: its configuration is not in it")
        return self.configuration

    def require_whole(self, *beginnings: str) -> None:
        """CheckFailed where something is damaged whose name begins so."""
        if named := [name for name in self.damaged if name.startswith(beginnings)]:
            raise CheckFailed(
                f"{self.file}: damaged: the checksum of {', '.join(named)} in it is wrong, and this needs it; "
                "`recording view`, `report` and `export` need the rows only"
            )

    def summary(self) -> str:
        """What it is, in a line."""
        rows = f"{self.end['rows']} cycles" if "rows" in self.end else "not ended in order, cycles"
        lost = f", {self.end['lost']} lost" if self.end.get("lost") else ""
        return (
            f"{self.file.name} (mcap, ours): axes {', '.join(self.axes)}; {rows} of {self.period_ns / 1e3:g} us{lost}"
        )

    def damage(self) -> str:
        """What beside the rows can't be trusted, in a sentence; empty where all of it can."""
        return f"Damaged, and left out: {', '.join(self.damaged)}." if self.damaged else ""

    def names(self) -> dict[str, str]:
        """Paths by the names that their columns have: ``cycle``, ``strain_um_x``."""
        found = {name: name for name in self.dtype.names or () if self.dtype[name].subdtype is None}
        fields = self.dtype["axis"].base.names or ()
        return found | {f"{name}_{axis}": f"axis.{k}.{name}" for k, axis in enumerate(self.axes) for name in fields}

    def table(self) -> Table:
        """Columns ``t_s``, by the counter of cycles so that a skipped one shows, and those of `names`."""
        columns: dict[str, Array | Callable[[], Array]] = {"t_s": self._time}
        for name, path in self.names().items():
            columns[name] = self._reading(path)
        return Table(self.file, columns)

    def column(self, path: str) -> NDArray[Any]:
        """One column, whole, in its own type. CheckFailed where that is too much, or the file is damaged."""
        return self.columns(path)[path]

    def columns(self, *paths: str) -> dict[str, NDArray[Any]]:
        """Several at once: the file is read, and its blocks are unpacked, once for all of them."""
        found: dict[str, list[NDArray[Any]]] = {path: [] for path in paths}
        total = 0
        for part in self.parts(list(paths)):
            for path, values in found.items():
                values.append(part[path])
            total += len(part[paths[0]])
            if total > _MOST_VALUES:
                raise CheckFailed(
                    f"{self.file}: {total} rows are more than can be read; cut it: micromanip recording export --cut"
                )
        return {path: np.concatenate(values) if values else np.empty(0) for path, values in found.items()}

    def _reading(self, path: str) -> Callable[[], Array]:
        return lambda: np.asarray(self.column(path), dtype=float)

    def _time(self) -> Array:
        cycles = self.column("cycle")
        return np.asarray((cycles - cycles[:1]) * (self.period_ns * 1e-9), dtype=float)
