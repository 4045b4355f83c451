"""What an axis has learned of a part, and the file that keeps it: whole or not at all, and of this cell only.

A file is a zip of arrays (``.npz``, with a check sum each) and one JSON text. It is replaced by rename once it is on
the disk: a power cut leaves the memory before. It names format, cell, axis, tuning, tool and path; what belongs to
another one is refused.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import Array
from micromanip.errors import CheckFailed, MicromanipError, system_error
from micromanip.files import HeldFolder, open_regular
from micromanip.settings.schema.axis import HASH_DIGITS
from micromanip.settings.schema.model import Configuration
from micromanip.settings.tuning_hash import tuning_hash

_FORMAT = 1
_JSON = "memory.json"
_ASIDE = ".before_fault"
_MOST_BYTES = 500_000_000
_CYCLES = 2.0
"""A memory has a value in several cycles: its part is that long to a value or two."""


@dataclass(frozen=True)
class Memory:
    """An axis' memory of one path, n values of a part each, um; what is known after `parts` parts, and what is played.

    `mean_um` is the error that is there without a correction, `spread_um2` (bands,) its variance from part to part.
    `contraction` is what is left, at worst, of a wrong correction after one more part; `learned_Hz` the bands in which
    something is. `blocks_um2` are the mean squares of the last part's error, in band, in order; `generation` counts
    what was played. `tool` is 0 where none is named; `temperature_C` that of the cell in the parts' mean, None where
    nobody measures it.
    """

    cell: str
    axis: str
    tuning: str
    rate_hz: float
    path_um: Array
    mean_um: Array
    correction_um: Array
    spread_um2: Array = field(default_factory=lambda: np.zeros(0))
    blocks_um2: Array = field(default_factory=lambda: np.zeros(0))
    parts: int = 0
    contraction: float = 0.0
    learned_Hz: tuple[tuple[float, float], ...] = ()
    generation: int = 0
    tool: int = 0
    temperature_C: float | None = None

    @classmethod
    def begun(
        cls, configuration: Configuration, axis: str, rate_hz: float, path_um: Array, tool: int,
        temperature_C: float | None,
    ) -> Memory:  # fmt: skip
        """One that knows its part only, and how it was made."""
        nothing = np.zeros(len(path_um))
        return cls(
            cell_name(configuration), axis, tuning_hash(configuration.axes[axis]), rate_hz, path_um, nothing, nothing,
            tool=tool, temperature_C=temperature_C,
        )  # fmt: skip

    @property
    def seconds(self) -> float:
        """How long the part is."""
        return len(self.path_um) / self.rate_hz

    @property
    def path(self) -> str:
        """What the path is known by: a hash of it, to a hundredth of a micrometre."""
        return _digest(np.round(self.path_um, 2).tobytes())

    def forgotten(self) -> Memory:
        """Of the same path, with nothing learned."""
        nothing = np.zeros(len(self.path_um))
        return replace(
            self, parts=0, mean_um=nothing, correction_um=nothing, spread_um2=np.zeros(0), blocks_um2=np.zeros(0),
            contraction=0.0, learned_Hz=(),
        )  # fmt: skip

    def require(self, configuration: Configuration, axis: str, file: Path) -> None:
        """Raise CheckFailed where it, in `file`, is not of this cell's axis, as that is tuned, and its parts."""
        learning = configuration.learning
        assert learning is not None
        tuning = tuning_hash(configuration.axes[axis])
        asked = {"cell": cell_name(configuration), "axis": axis, "tuning": tuning}
        told = [f"of {name} {getattr(self, name)}, not of {want}" for name, want in asked.items()
                if getattr(self, name) != want]  # fmt: skip
        if abs(self.seconds - learning.seconds) * self.rate_hz > _CYCLES:
            told.append(f"of a part of {self.seconds:g} s, learning.seconds says {learning.seconds:g}")
        if told:
            raise CheckFailed(f"{file}: this memory is {told[0]}: learn anew, after `micromanip learn reset`")


def cell_name(configuration: Configuration) -> str:
    """What a cell is known by: a hash of its drivers, signals and outputs, but for the seed of a simulation."""
    drivers = {
        name: {key: value for key, value in driver.model_dump(mode="json").items() if key != "seed"}
        for name, driver in configuration.drivers.items()
    }
    wired = {
        name: {key: each.model_dump(mode="json") for key, each in getattr(configuration, name).items()}
        for name in ("signals", "outputs")
    }
    text = json.dumps({"drivers": drivers, **wired}, sort_keys=True, default=str)
    return _digest(text.encode())


def memory_file(folder: Path, axis: str, tool: int = 0) -> Path:
    """Where the memory of `axis` with `tool` lies."""
    return folder / (f"{axis}.tool{tool}.npz" if tool else f"{axis}.npz")


def memory_files(folder: Path, axis: str) -> list[Path]:
    """The memories of `axis` in `folder`, of all tools; whether they are good is not looked at."""
    named = re.compile(re.escape(axis) + r"(\.tool\d+)?\.npz")
    return sorted(file for file in folder.glob("*.npz") if named.fullmatch(file.name))


def memory_warnings(configuration: Configuration, folder: Path) -> list[str]:
    """A sentence for each memory in `folder` that `run` would not use; an axis that has none yet is not missed."""
    found = []
    for name in configuration.axes:
        for file in memory_files(folder, name):
            try:
                read_memory(file).require(configuration, name, file)
            except MicromanipError as problem:
                found.append(f"{problem}; nothing would be learned or played of axis {name}")
    return found


def put_aside(file: Path) -> Path:
    """Keep a memory under a name that nobody takes it from, in the place of an older one. MicromanipError."""
    try:
        return file.replace(file.with_name(file.name + _ASIDE))
    except OSError as problem:
        raise system_error(problem, file) from None


def remove_memory(file: Path) -> None:
    """Remove a memory, a damaged one too. CheckFailed where the file is another archive, MicromanipError."""
    try:
        with contextlib.suppress(zipfile.BadZipFile), zipfile.ZipFile(file) as found:
            if f"{_JSON}.npy" not in found.namelist():
                raise CheckFailed(f"{file}: no memory of learning: it stays")
        file.unlink()
    except OSError as problem:
        raise system_error(problem, file) from None


_ARRAYS = ("path_um", "mean_um", "correction_um", "spread_um2", "blocks_um2")
_VALUES = ("cell", "axis", "tuning", "rate_hz", "parts", "contraction", "learned_Hz", "generation", "tool",
           "temperature_C")  # fmt: skip


def write_memory(file: Path, memory: Memory) -> None:
    """Replace the file, once the new one is whole on the disk. Raises OSError where it can't be."""
    told = {"format": _FORMAT, "path": memory.path, **{name: getattr(memory, name) for name in _VALUES}}
    arrays = {name: getattr(memory, name) for name in _ARRAYS}
    content = io.BytesIO()
    np.savez(content, **{_JSON: np.frombuffer(json.dumps(told).encode(), np.uint8)}, **arrays)  # type: ignore[arg-type]
    with HeldFolder(file.parent, make=True) as folder:
        folder.write(file.name, content.getvalue())


def read_memory(file: Path) -> Memory:
    """The memory in `file`. CheckFailed where it is none, or damaged, MicromanipError where it can't be read."""
    try:
        with open_regular(file, _MOST_BYTES) as opened, np.load(opened, allow_pickle=False) as found:
            arrays = {name: found[name] for name in found.files}
        return _memory(arrays)
    except (zipfile.BadZipFile, ValueError, KeyError, TypeError, EOFError) as problem:
        raise CheckFailed(
            f"{file}: no memory of learning, or a damaged one ({problem}): remove it, or `micromanip learn reset`"
        ) from None
    except OSError as problem:
        raise system_error(problem, file) from None


def _memory(arrays: Mapping[str, NDArray[Any]]) -> Memory:
    told = json.loads(bytes(arrays[_JSON]))
    if told["format"] != _FORMAT:
        raise ValueError(f"it is of format {told['format']}, of another version; this program knows {_FORMAT}")
    rows: dict[str, Any] = {name: arrays[name] for name in _ARRAYS}
    for name, row in rows.items():
        if not (row.dtype == np.float64 and row.ndim == 1 and np.isfinite(row).all()):
            raise ValueError(f"{name} is not a row of finite numbers")
    if not len(rows["path_um"]) == len(rows["mean_um"]) == len(rows["correction_um"]):
        raise ValueError("its arrays are not all as long as the part")
    values: dict[str, Any] = {name: told[name] for name in _VALUES}
    values["learned_Hz"] = tuple((float(low), float(high)) for low, high in told["learned_Hz"])
    memory = Memory(**rows, **values)
    if memory.path != told["path"] or not memory.rate_hz > 0.0:
        raise ValueError("its path is not the one that it names")
    return memory


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:HASH_DIGITS]
