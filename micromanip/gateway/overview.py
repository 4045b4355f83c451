"""A long recording as least and greatest values of blocks of cycles, in a file that fills as its pieces are read.

One process fills it, another shows what is there already. It lies in the user's cache, by the recording's path, size
and time of change: whoever opens the same recording again finds it made.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, system_error
from micromanip.files import own_temporary_folder
from micromanip.recordings import Telemetry

from .fields import Field
from .history import Cycles, Values, extremes

_FINE, _STEP = 32, 32
"""Cycles in a block of the fine level; blocks of it in one of the coarse level."""
_MOST_BYTES, _KEPT_BYTES = 1_000_000_000, 5_000_000_000
"""Of one overview, with longer blocks for a longer recording; of all that are kept."""
_LAYOUT = 3


class Level:
    """Blocks of `per` cycles from the cycle `origin` on: `count` (n,) rows in each so far, 0 where none is known.

    `low` and `high` are (n, fields): what is read together lies together, which fills three times as fast.
    """

    def __init__(self, per: int, origin: int, count: NDArray[np.int32], low: Values, high: Values) -> None:
        self.per, self.origin = per, origin
        self.count, self._low, self._high = count, low, high

    def add(self, cycles: Cycles, values: Values) -> None:
        """Rows (n,) in order, their values (fields, n)."""
        blocks = (cycles - self.origin) // self.per
        begins = np.flatnonzero(np.diff(blocks, prepend=-1))
        at = blocks[begins]
        low, high = (each.T for each in extremes(values, values, begins))
        new = (self.count[at] == 0)[:, None]
        self._low[at] = np.where(new, low, np.fmin(self._low[at], low))
        self._high[at] = np.where(new, high, np.fmax(self._high[at], high))
        self.count[at] += np.diff(begins, append=len(cycles)).astype(np.int32)

    def taken(self, columns: Sequence[int], first: int, last: int) -> tuple[Cycles, NDArray[np.int32], Values, Values]:
        """Of the blocks that have cycles from `first` to `last`: where they begin, rows (n,), least and greatest."""
        part = slice(max(0, (first - self.origin) // self.per), max(0, (last - self.origin) // self.per + 1))
        count = np.array(self.count[part])
        begins = self.origin + self.per * np.arange(part.start, part.start + len(count), dtype=np.int64)
        low, high = (np.array(values[part][:, columns]).T for values in (self._low, self._high))
        low[:, count == 0] = high[:, count == 0] = np.nan
        return begins, count, low, high


class Overview:
    """The file: `levels`, fine first; `done` (pieces,), which of them are in it; `wanted`, cycles to read first."""

    def __init__(self, folder: Path, about: dict[str, Any]) -> None:
        self.folder, self.about = folder, about
        self.done = _mapped(folder / "done", np.uint8, (about["pieces"],))
        self.wanted = _mapped(folder / "wanted", np.int64, (2,))
        self.levels = []
        for k, (per, blocks) in enumerate(about["levels"]):
            shape = (blocks, len(about["fields"]))
            count = _mapped(folder / f"count-{k}", np.int32, (blocks,))
            low, high = (_mapped(folder / f"{name}-{k}", np.float32, shape) for name in ("low", "high"))
            self.levels.append(Level(per, about["first"], count, low, high))

    @property
    def share(self) -> float:
        """How much of the recording is in it."""
        return float(np.count_nonzero(self.done)) / len(self.done)

    def notes(self) -> list[tuple[int, int, str, str]]:
        """Faults and damage found so far: first and last cycle, kind (``fault`` or ``damage``), text."""
        try:
            lines = (self.folder / "notes").read_text().splitlines()
        except FileNotFoundError:
            return []
        found = (line.split(" ", 3) for line in lines)
        return sorted({(int(first), int(last), kind, text) for first, last, kind, text in found})

    def note(self, first: int, last: int, kind: str, text: str) -> None:
        """One more of `notes`."""
        with (self.folder / "notes").open("a") as notes:
            notes.write(f"{first} {last} {kind} {text.splitlines()[0]}\n")

    def alone(self) -> Any | None:
        """What keeps others from filling it, as long as it is held; None where somebody does."""
        held = (self.folder / "lock").open("w")
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            held.close()
            return None
        return held


def open_overview(telemetry: Telemetry, fields: Sequence[Field], first: int, last: int, pieces: int) -> Overview:
    """That of a recording of the cycles `first` to `last` in so many pieces; a new one is empty.

    Raises what `errors.system_error` makes of a cache without room.
    """
    status = telemetry.file.stat()
    names = [field.name for field in fields]
    about: dict[str, Any] = {
        "layout": _LAYOUT, "file": str(telemetry.file.resolve()), "bytes": status.st_size,
        "mtime_ns": status.st_mtime_ns, "first": first, "last": last, "pieces": pieces, "fields": names,
    }  # fmt: skip
    key = hashlib.sha256(json.dumps(about).encode()).hexdigest()[:24]
    per = _FINE
    while (last - first) // per * len(names) * 8 > _MOST_BYTES:
        per *= 2
    about["levels"] = [[size, (last - first) // size + 1] for size in (per, per * _STEP)]
    root = cache_folder()
    try:
        folder = root / key
        if not (folder / "about.json").exists():
            _drop_oldest(root)
            _make(folder, about)
        os.utime(folder)
    except OSError as problem:
        raise system_error(problem, root) from problem
    return Overview(folder, about)


def reopened(folder: Path) -> Overview:
    """One that `open_overview` has made."""
    return Overview(folder, json.loads((folder / "about.json").read_text()))


def cache_folder() -> Path:
    """Where overviews are kept: they may be removed at any time."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = (Path(base) if base else Path.home() / ".cache") / "micromanip" / "overviews"
        folder.mkdir(parents=True, exist_ok=True)
    except (RuntimeError, OSError):  # without a home, or one that can't be written to
        folder = own_temporary_folder() / "overviews"
        folder.mkdir(exist_ok=True)
    return folder


def _make(folder: Path, about: dict[str, Any]) -> None:
    """All files of an overview at their size, and the room for them taken; then they are put there together."""
    with tempfile.TemporaryDirectory(dir=folder.parent) as name:
        draft = Path(name) / "overview"
        draft.mkdir()
        sizes = {"done": about["pieces"], "wanted": 16}
        for k, (_, blocks) in enumerate(about["levels"]):
            values = 4 * blocks * len(about["fields"])
            sizes |= {f"count-{k}": 4 * blocks, f"low-{k}": values, f"high-{k}": values}
        for file, size in sizes.items():
            with (draft / file).open("wb") as made:
                os.posix_fallocate(made.fileno(), 0, size)
        (draft / "about.json").write_text(json.dumps(about))
        if folder.exists():
            shutil.rmtree(folder)
        draft.rename(folder)


def _drop_oldest(root: Path) -> None:
    """Those not looked at for longest go, until the rest is within the bound."""
    found = sorted((each for each in root.iterdir() if each.is_dir()), key=lambda each: -each.stat().st_mtime)
    total = 0
    for folder in found:
        total += sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
        if total > _KEPT_BYTES - _MOST_BYTES:
            shutil.rmtree(folder, ignore_errors=True)


def _mapped(file: Path, kind: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    try:
        return np.memmap(file, kind, "r+", shape=shape)
    except (OSError, ValueError) as problem:
        raise CheckFailed(f"{file}: {problem}; remove the folder, it is made again") from problem
