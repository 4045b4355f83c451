"""What an axis has learned of a part, and the file that keeps it: whole or not at all, and of this cell only.

A file is a zip of arrays (``.npz``, with a check sum each) and one JSON text. It is replaced by rename once it is on
the disk: a power cut leaves the memory before. It names format, cell, axis, tuning and path, and what belongs to
another one is refused.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.learned import ASIDE
from micromanip.errors import CheckFailed, UsageError, system_error
from micromanip.files import HeldFolder, open_regular
from micromanip.settings.schema.axis import HASH_DIGITS
from micromanip.settings.schema.model import Configuration

Array = NDArray[np.float64]

FORMAT = 2
_READ = (1, FORMAT)
"""The first knew neither tool nor temperature: it is of no tool that was told."""
_TOLD = "memory.json"
_MOST_BYTES = 500_000_000
_MOST_ASIDE = 9


@dataclass(frozen=True)
class Learned:
    """What is known after `parts` parts, n values of one part each, and what is played because of it.

    `mean_um` is the error that is there without a correction, `spread_um2` its variance from part to part in bands of
    frequency. `contraction` is what is left, at worst, of a wrong correction after one more part; `learned_Hz` the
    bands in which something is.
    """

    parts: int
    mean_um: Array
    spread_um2: Array
    correction_um: Array
    contraction: float
    learned_Hz: tuple[tuple[float, float], ...]

    @classmethod
    def nothing(cls, values: int) -> Learned:
        """Of a part of so many values."""
        return cls(0, np.zeros(values), np.zeros(0), np.zeros(values), 0.0, ())


@dataclass(frozen=True)
class Memory:
    """An axis' memory of one path. `blocks_um2` are the mean squares of the last part's error, in band, in order.

    `before` is what was played before `now`, None where nothing was; `generation` counts what was played, `story` has
    an entry for each part. `tool` is the number of the tool that it was learned with, 0 where none was told;
    `temperature_C` that of the cell in the parts' mean, None where nobody measures it. What `repeats` goes round and
    round: its end is its beginning.
    """

    cell: str
    axis: str
    tuning: str
    rate_hz: float
    begin_s: float
    path_um: Array
    now: Learned
    before: Learned | None = None
    generation: int = 0
    blocks_um2: Array = field(default_factory=lambda: np.zeros(0))
    story: tuple[Mapping[str, Any], ...] = ()
    tool: int = 0
    temperature_C: float | None = None
    repeats: bool = False

    @property
    def seconds(self) -> float:
        """How long the part is."""
        return len(self.path_um) / self.rate_hz

    @property
    def path(self) -> str:
        """What the path is known by: a hash of it, to a hundredth of a micrometre."""
        return _digest(np.round(self.path_um, 2).tobytes())

    def require(self, cell: str, axis: str, tuning: str, what: str) -> None:
        """Raise CheckFailed where the memory is of something else than what is asked for."""
        for name, own, asked in (("cell", self.cell, cell), ("axis", self.axis, axis), ("tuning", self.tuning, tuning)):
            if own != asked:
                raise CheckFailed(
                    f"{what}: this memory is of {name} {own}, not of {asked}: learn anew, into another folder, or "
                    "after `micromanip learn reset`"
                )


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


def memory_file(folder: Path, axis: str, tool: int = 0, temperature_C: float | None = None) -> Path:
    """Where a memory of `axis` lies, begun with `tool` at a temperature. UsageError for what is no axis' name."""
    if Path(axis).name != axis:
        raise UsageError(f"{axis!r} is no name of an axis")
    with_tool = f".tool{tool}" if tool else ""
    warm = "" if temperature_C is None else f".{temperature_C:.1f}C"
    return folder / f"{axis}{with_tool}{warm}.npz"


def memory_files(folder: Path, axis: str) -> list[Path]:
    """The memories of `axis` in `folder`, of all tools and temperatures; whether they are good is not looked at."""
    named = re.compile(re.escape(memory_file(folder, axis).stem) + r"(\.tool\d+)?(\.-?\d+\.\dC)?\.npz")
    return sorted(file for file in folder.glob("*.npz") if named.fullmatch(file.name))


def put_aside(file: Path) -> Path:
    """Keep a memory under a name that nobody takes it from, nor is another's; that. MicromanipError where it can't be.

    Of more than `_MOST_ASIDE` the last gives way: a cell that trips after each part does not fill the disk.
    """
    first = file.with_name(file.name + ASIDE)
    names = [first, *(first.with_name(f"{first.name}.{k}") for k in range(2, _MOST_ASIDE + 1))]
    try:
        return file.replace(next((name for name in names if not name.exists()), names[-1]))
    except OSError as problem:
        raise system_error(problem, file) from None


def write_memory(file: Path, memory: Memory) -> None:
    """Replace the file, once the new one is whole on the disk. Raises OSError where it can't be."""
    told = {
        "format": FORMAT, "cell": memory.cell, "axis": memory.axis, "tuning": memory.tuning, "path": memory.path,
        "rate_hz": memory.rate_hz, "begin_s": memory.begin_s, "generation": memory.generation, "now": _told(memory.now),
        "before": None if memory.before is None else _told(memory.before), "story": list(memory.story),
        "tool": memory.tool, "temperature_C": memory.temperature_C, "repeats": memory.repeats,
    }  # fmt: skip
    arrays = {"path_um": memory.path_um, "blocks_um2": memory.blocks_um2, **_arrays("now", memory.now)}
    if memory.before is not None:
        arrays |= _arrays("before", memory.before)
    content = io.BytesIO()
    np.savez(content, **{_TOLD: np.frombuffer(json.dumps(told).encode(), np.uint8)}, **arrays)  # type: ignore[arg-type]
    with HeldFolder(file.parent, make=True) as folder:
        folder.write(file.name, content.getvalue())


def read_memory(file: Path) -> Memory | None:
    """The memory in `file`, None where there is no file. CheckFailed where it is none, or damaged."""
    try:
        with open_regular(file, _MOST_BYTES) as opened, np.load(opened, allow_pickle=False) as found:
            arrays = {name: found[name] for name in found.files}
        return _memory(arrays)
    except FileNotFoundError:
        return None
    except (zipfile.BadZipFile, ValueError, KeyError, TypeError, EOFError) as problem:
        raise CheckFailed(
            f"{file}: no memory of `micromanip learn`, or a damaged one ({problem}): "
            f"`micromanip learn reset --axis {file.stem}` removes a damaged one"
        ) from None
    except OSError as problem:
        raise system_error(problem, file) from None


def remove_memory(file: Path) -> None:
    """Remove a memory, a damaged one too. CheckFailed where it is none, MicromanipError where it can't be."""
    try:
        with zipfile.ZipFile(file) as found:
            if f"{_TOLD}.npy" not in found.namelist():
                raise CheckFailed(f"{file}: no memory of `micromanip learn`: it stays")
    except zipfile.BadZipFile:
        pass
    except OSError as problem:
        raise system_error(problem, file) from None
    try:
        file.unlink()
    except OSError as problem:
        raise system_error(problem, file) from None


def _memory(arrays: Mapping[str, NDArray[Any]]) -> Memory:
    told = json.loads(bytes(arrays[_TOLD]))
    if told["format"] not in _READ:
        raise ValueError(f"it is of format {told['format']}, of another version; this program knows {FORMAT}")
    for name, values in arrays.items():
        if name != _TOLD and not (values.dtype == np.float64 and values.ndim == 1 and np.isfinite(values).all()):
            raise ValueError(f"{name} is not a row of finite numbers")
    warm = told.get("temperature_C")
    memory = Memory(
        told["cell"], told["axis"], told["tuning"], float(told["rate_hz"]), float(told["begin_s"]), arrays["path_um"],
        _learned("now", told["now"], arrays),
        None if told["before"] is None else _learned("before", told["before"], arrays),
        int(told["generation"]), arrays["blocks_um2"], tuple(told["story"]), int(told.get("tool", 0)),
        None if warm is None else float(warm), bool(told.get("repeats", False)),
    )  # fmt: skip
    if memory.path != told["path"] or not memory.rate_hz > 0.0:
        raise ValueError("its path is not the one that it names")
    return memory


def _told(learned: Learned) -> dict[str, Any]:
    return {"parts": learned.parts, "contraction": learned.contraction, "learned_Hz": learned.learned_Hz}


def _arrays(name: str, learned: Learned) -> dict[str, Array]:
    return {f"{name}.{key}": getattr(learned, key) for key in ("mean_um", "spread_um2", "correction_um")}


def _learned(name: str, told: Mapping[str, Any], arrays: Mapping[str, Array]) -> Learned:
    mean, spread, correction = (arrays[f"{name}.{key}"] for key in ("mean_um", "spread_um2", "correction_um"))
    if not len(mean) == len(correction) == len(arrays["path_um"]):
        raise ValueError("its arrays are not all as long as the part")
    bands = tuple((float(low), float(high)) for low, high in told["learned_Hz"])
    return Learned(int(told["parts"]), mean, spread, correction, float(told["contraction"]), bands)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:HASH_DIGITS]
