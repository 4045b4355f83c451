"""The trip store: each trip as a file, the folder of all of them, and what waits for room there.

A trip is a ``.npz`` without pickles, so that any numpy reads it:

- ``rows``: each cycle from 2 s before to 0.5 s after the trip (``micromanip.rt.telemetry.ROW``)
- ``parameters``: each set of parameters that was in force in them; a row's ``version`` names one
- ``state``: the loop's whole state (1,) as soon as the trip was seen
- ``events``: the faults and warnings that were raised last, in their order (``micromanip.rt.faults.EVENT``)
- ``meta``: a JSON document: the trip, the configuration's text and hash, the axes, the clocks (see `TripRecord.meta`)
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import time
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, PermissionDenied, UsageError
from micromanip.files import held, open_regular
from micromanip.host.state_directory import state_directory

FORMAT = 1
SUFFIX, PARTIAL = ".npz", ".part"
KEPT = 50
SYSTEM = Path("/var/lib/micromanip/trips")
_PARTS = ("rows", "parameters", "state", "events")
_NAME = re.compile(r"\d{8}T\d{6}\.\d{3}Z_.+\.npz")
_ABANDONED_S = 60.0
_RETRY_S = 3.0
_KEPT_IN_MEMORY = 4


@dataclass(frozen=True)
class TripRecord:
    """What is known of one trip.

    `meta` has the keys ``format``, ``trip`` (`micromanip.status_reply.Fault` with its number and message),
    ``complete``, ``utc``, ``monotonic_ns`` and ``utc_ns`` (both of the trip), ``period_ns``, ``axes``,
    ``drivers``, ``configuration`` (its text), ``sha256``, ``path``.
    """

    meta: dict[str, Any]
    rows: NDArray[Any]
    parameters: NDArray[Any]
    state: NDArray[Any]
    events: NDArray[Any]

    @property
    def trip(self) -> dict[str, Any]:
        """Code, number, axis, value, limit, cycle, what was seen and message of the trip."""
        trip: dict[str, Any] = self.meta["trip"]
        return trip

    @property
    def seen(self) -> str:
        """What tripped, in a sentence."""
        return str(self.trip["seen"])

    def save(self, file: Path) -> None:
        """Write the file whole or not at all: once it has its name it is on the disk. Raises OSError."""
        write = np.savez_compressed if self.meta["complete"] else np.savez  # the first must be quick
        content = io.BytesIO()
        write(
            content,
            allow_pickle=False,
            meta=np.array(json.dumps(self.meta)),
            **{part: getattr(self, part) for part in _PARTS},
        )
        with held(file) as (folder, name):
            folder.write(name, content.getvalue())

    @classmethod
    def load(cls, file: Path) -> TripRecord:
        """Read a file; raises CheckFailed where it is none, or damaged."""
        try:
            with open_regular(file) as stream, np.load(stream, allow_pickle=False) as stored:
                meta = json.loads(str(stored["meta"]))
                if meta["format"] != FORMAT:
                    raise CheckFailed(f"{file} has format {meta['format']}; this version reads format {FORMAT}")
                return cls(meta, *(stored[part] for part in _PARTS))
        except OSError as problem:
            raise CheckFailed(f"{file} can't be read: {problem.strerror or problem}") from problem
        except (ValueError, LookupError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as problem:
            raise CheckFailed(f"{file} is no black box, or it is damaged") from problem


def default_folder() -> Path:
    """Where a controller that is started here puts its trips."""
    return state_directory() / "trips"


def folder_to_read(system: Path = SYSTEM) -> Path:
    """Where to look for trips: the system's service's where there is one, else as a controller that is started here."""
    with contextlib.suppress(PermissionError):
        return default_folder() if "STATE_DIRECTORY" in os.environ or not system.is_dir() else system
    return system


def file_name(utc_ns: int, code: str, axis: str | None) -> str:
    """``20260314T101502.250Z_X-201_x.npz``: names in the order of time."""
    at = datetime.fromtimestamp(utc_ns // 1_000_000 / 1e3, UTC)
    parts = [f"{at:%Y%m%dT%H%M%S}.{at.microsecond // 1000:03d}Z", code, *([axis] if axis else [])]
    return "_".join(parts) + SUFFIX


def trips(folder: Path) -> list[Path]:
    """All trips, the newest last; none where the folder does not exist. Raises PermissionDenied."""
    try:
        return sorted(entry for entry in folder.iterdir() if _NAME.fullmatch(entry.name))
    except (FileNotFoundError, NotADirectoryError):
        return []
    except PermissionError as problem:
        raise PermissionDenied(
            f"{folder}: not allowed; your user must be in the controller's group, or name another folder with --trips"
        ) from problem


def find(folder: Path, wanted: str | None) -> Path:
    """The trip that is meant by a path, a name or the beginning of one; the newest without any.

    Raises UsageError where there is none, or more than one.
    """
    if wanted is not None and Path(wanted).is_file():
        return Path(wanted)
    known = trips(folder)
    if wanted is None:
        if not known:
            raise UsageError(f"there are no trips in {folder}; name another folder with --trips")
        return known[-1]
    meant = [file for file in known if file.name.startswith(wanted)]
    if len(meant) == 1:
        return meant[0]
    if meant:
        raise UsageError(f"{len(meant)} trips in {folder} begin with {wanted}; `micromanip trip list` shows them")
    raise UsageError(f"there is no trip {wanted} in {folder}; `micromanip trip list` shows what there is")


def prune(folder: Path, kept: int = KEPT) -> None:
    """Remove all but the newest `kept` trips, and what a writer that died has left."""
    for old in trips(folder)[:-kept]:
        old.unlink(missing_ok=True)
    for entry in folder.glob(f".*{PARTIAL}"):
        with contextlib.suppress(FileNotFoundError):
            if time.time() - entry.stat().st_mtime > _ABANDONED_S:
                entry.unlink()


def summary(file: Path) -> dict[str, str | bool | None]:
    """One line of the list: name, time, code, axis, what was seen, message; of a damaged file what is wrong with it."""
    try:
        box = TripRecord.load(file)
        trip, utc, seen, complete = box.trip, box.meta["utc"], box.seen, box.meta["complete"]
    except CheckFailed as problem:
        trip, utc, seen, complete = {"code": None, "axis": None, "message": str(problem)}, None, str(problem), False
    shown = {key: trip[key] for key in ("code", "axis", "message")}
    return {"trip": file.stem, "utc": utc, "seen": seen, "complete": complete, **shown}


class TripArchive:
    """Puts boxes on disk; what a full disk refuses is kept in memory, and tried again."""

    def __init__(self, folder: Path, kept: int, send: Callable[..., None]) -> None:
        """`kept` of them stay; `send` hears what becomes of each, as keywords."""
        self.folder, self._kept, self._send = folder, kept, send
        self._waiting: dict[Path, tuple[TripRecord, int]] = {}
        self._next_try = 0.0

    def put(self, box: TripRecord, key: int) -> None:
        """Save `box`, or keep it for later; `key` is what the host knows the trip by."""
        trip = box.trip
        file = self.folder / file_name(box.meta["utc_ns"], trip["code"], trip["axis"])
        first = file not in self._waiting
        problem = self._save(file, box)
        if problem is None:
            self._waiting.pop(file, None)
            self._send(key=key, file=str(file), code=trip["code"], complete=box.meta["complete"])
            return
        if first:
            self._send(key=key, file=str(file), code=trip["code"], problem=problem)
        self._waiting[file] = (box, key)
        while len(self._waiting) > _KEPT_IN_MEMORY:
            self._lose(min(self._waiting), "more trips came than can be kept in memory")
        self._next_try = time.monotonic() + _RETRY_S

    def retry(self) -> None:
        """Try what is waiting again, every few seconds."""
        if self._waiting and time.monotonic() >= self._next_try:
            self.flush()

    def flush(self) -> None:
        """Try what is waiting again, now."""
        for box, key in list(self._waiting.values()):
            self.put(box, key)

    def give_up(self) -> None:
        """A last try; what can't be written even now is lost."""
        self.flush()
        for file in list(self._waiting):
            self._lose(file, "the controller ended before it could be written")

    def _lose(self, file: Path, why: str) -> None:
        box, key = self._waiting.pop(file)
        self._send(key=key, file=str(file), code=box.trip["code"], lost=why)

    def _save(self, file: Path, box: TripRecord) -> str | None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            box.save(file)
            prune(self.folder, self._kept)
        except OSError as problem:
            return problem.strerror or str(problem)
        return None
