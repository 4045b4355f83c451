"""The folder of all trips: where it is, how its files are named, how many are kept."""

from __future__ import annotations

import contextlib
import os
import re
import time
from datetime import UTC, datetime
from pathlib import Path

from micromanip.errors import CheckFailed, PermissionDenied, UsageError
from micromanip.host.state_directory import state_directory

from .box import PARTIAL, Box

SUFFIX = ".npz"
KEPT = 50
SYSTEM = Path("/var/lib/micromanip/trips")
_NAME = re.compile(r"\d{8}T\d{6}\.\d{3}Z_.+\.npz")
_ABANDONED_S = 60.0


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
        raise UsageError(f"{len(meant)} trips in {folder} begin with {wanted}; `micromanip explain --list` shows them")
    raise UsageError(f"there is no trip {wanted} in {folder}; `micromanip explain --list` shows what there is")


def prune(folder: Path, kept: int = KEPT) -> None:
    """Remove all but the newest `kept` trips, and what a writer that died has left."""
    for old in trips(folder)[:-kept]:
        old.unlink(missing_ok=True)
    for entry in folder.glob(f".*{PARTIAL}"):
        with contextlib.suppress(FileNotFoundError):
            if time.time() - entry.stat().st_mtime > _ABANDONED_S:
                entry.unlink()


def summary(file: Path) -> dict[str, str | bool | None]:
    """One line of the list: name, time, code, axis, message; of a damaged file what is wrong with it."""
    try:
        box = Box.load(file)
    except CheckFailed as problem:
        return {"trip": file.stem, "utc": None, "code": None, "axis": None, "message": str(problem), "complete": False}
    trip = box.trip
    return {
        "trip": file.stem,
        "utc": box.meta["utc"],
        "code": trip["code"],
        "axis": trip["axis"],
        "message": trip["message"],
        "complete": box.meta["complete"],
    }
