"""What a file of ours is about, as the catalogue keeps it. A file of somebody else is passed over."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import yaml

from micromanip.design.commission.history import carried
from micromanip.design.trend import whole
from micromanip.errors import CheckFailed
from micromanip.faults import KINDS
from micromanip.host.trips.store import SUFFIX, Box
from micromanip.recordings import Telemetry, open_telemetry
from micromanip.recordings.trend import MINUTE, day_file, read_trend
from micromanip.rt.states import TRACKING

_TRIP = re.compile(r"\d{8}T\d{6}\.\d{3}Z_.+\.npz")
_MOST_TUNING_BYTES = 1_000_000


@dataclass(frozen=True)
class Entry:
    """One file. `began` is ISO 8601 with its offset, `configuration` a SHA-256 or a tuning hash, `seconds` of the run.

    `rms_um` is the path error of each axis while tracking; `about` what people read, `problem` what is wrong with it.
    """

    path: Path
    kind: str
    began: str
    about: str
    seconds: float | None = None
    configuration: str = ""
    faults: tuple[str, ...] = ()
    rms_um: Mapping[str, float] = field(default_factory=dict)
    problem: str = ""


def may_be_ours(path: Path) -> bool:
    """By its name: whether `described` would look into it."""
    return path.suffix.lower() in _BY_ENDING


def described(path: Path) -> Entry | None:
    """The entry of a file; None where it is none of ours. A damaged one has a `problem`. Raises OSError."""
    describe = _BY_ENDING.get(path.suffix.lower())
    return None if describe is None else describe(path)


def _changed(path: Path) -> str:
    return datetime.fromtimestamp(path.stat().st_mtime, UTC).isoformat(timespec="seconds")


def _utc(told: str, path: Path) -> str:
    """A time of a file in the form of all others; that of its last change where it is none."""
    try:
        return datetime.fromisoformat(told).astimezone(UTC).isoformat(timespec="seconds")
    except ValueError:
        return _changed(path)


def _recording(path: Path) -> Entry | None:
    try:
        telemetry = open_telemetry(path)
    except CheckFailed as problem:
        return Entry(path, "recording", _changed(path), "", problem=str(problem))
    began = _utc(str(telemetry.marks[0]["time"]), path) if telemetry.marks else _changed(path)
    ended = "" if telemetry.end else "not ended in order"
    ended = "; ".join(filter(None, [ended, telemetry.damage()]))
    marks = [str(mark["text"]) for mark in telemetry.marks[1:]]
    try:
        seconds, faults, rms_um = _judged(telemetry)
    except CheckFailed as problem:
        return Entry(path, "recording", began, "", configuration=telemetry.sha256, problem=str(problem))
    about = "; ".join([f"axes {', '.join(telemetry.axes)}", *marks])
    return Entry(path, "recording", began, about, seconds, telemetry.sha256, faults, rms_um, ended)


def _judged(telemetry: Telemetry) -> tuple[float | None, tuple[str, ...], dict[str, float]]:
    """Length (s), faults, and path error of each axis while it tracks: in one pass, however long it is."""
    errors = {name: f"axis.{k}.path_error_um" for k, name in enumerate(telemetry.axes)}
    squares, counts = dict.fromkeys(errors, 0.0), dict.fromkeys(errors, 0)
    first, last = None, None
    faults: set[int] = set()
    for part in telemetry.parts(["cycle", "state", "fault", *errors.values()]):
        if not len(part["cycle"]):
            continue
        first, last = part["cycle"][0] if first is None else first, part["cycle"][-1]
        faults.update(int(number) for number in np.unique(part["fault"]) if number)
        tracks = part["state"] == TRACKING
        for name, path in errors.items():
            error = part[path][tracks]
            error = error[np.isfinite(error)]
            squares[name] += float(error @ error)
            counts[name] += len(error)
    seconds = None if first is None or last is None else float(last - first) * telemetry.period_ns * 1e-9
    codes = tuple(KINDS[number].code if number in KINDS else str(number) for number in sorted(faults))
    return seconds, codes, {name: math.sqrt(squares[name] / counts[name]) for name in errors if counts[name]}


def _trip(path: Path) -> Entry | None:
    if not _TRIP.fullmatch(path.name):
        return None
    try:
        box = Box.load(path)
    except CheckFailed as problem:
        return Entry(path, "trip", _changed(path), "", problem=str(problem))
    missing = "" if box.meta["complete"] else "what came after the trip is missing"
    began, code = _utc(str(box.meta["utc"]), path), str(box.trip["code"])
    return Entry(path, "trip", began, box.seen, None, str(box.meta["sha256"]), (code,), {}, missing)


def _report(path: Path) -> Entry | None:
    found = carried(path)
    if found is None:
        return None
    verdicts = [
        f"axis {axis}: {sum(each.passed for each in criteria)} of {len(criteria)} criteria"
        for axis, criteria in found.criteria.items()
    ]
    failed = [f"{each.axis}: {each.name}" for axis in found.criteria.values() for each in axis if not each.passed]
    about = "; ".join([*verdicts, *(["not met: " + ", ".join(failed)] if failed else [])])
    return Entry(path, "report", _utc(found.when, path), about, configuration=" ".join(found.hashes.values()))


def _tuning(path: Path) -> Entry | None:
    if path.stat().st_size > _MOST_TUNING_BYTES:
        return None
    text = path.read_bytes()
    try:
        document = yaml.safe_load(text)
    except yaml.YAMLError:
        return None
    if not isinstance(document, dict) or not {"schema_version", "axes", "drivers"} <= document.keys():
        return None
    commissioned = [
        f"axis {name} commissioned {axis['commissioned'].get('date', '')}"
        for name, axis in document["axes"].items()
        if isinstance(axis, dict) and isinstance(axis.get("commissioned"), dict)
    ]
    about = "; ".join(commissioned) or "not commissioned"
    return Entry(path, "tuning", _changed(path), about, configuration=hashlib.sha256(text).hexdigest())


def _trend(path: Path) -> Entry | None:
    """A day of minutes; its seconds say the same."""
    named = day_file(path)
    if named is None or named.every != MINUTE:
        return None
    try:
        trend = read_trend(path)
    except CheckFailed as problem:
        return Entry(path, "trend", f"{named.day}T00:00:00+00:00", "", problem=str(problem))
    found = whole(trend)
    rms_um = {name[len("error_um_") : -len("_rms")]: um for name, um in found.items() if name.startswith("error_um_")}
    known = {axis: um for axis, um in rms_um.items() if um is not None}
    about = f"axes {', '.join(rms_um)}; {len(trend.time)} minutes"
    seconds = float(np.nansum(trend.columns["seconds"]))
    return Entry(path, "trend", f"{trend.time[0]}+00:00", about, seconds, "", tuple(found["faults"]), known)


_BY_ENDING: dict[str, Callable[[Path], Entry | None]] = {
    ".mcap": _recording,
    SUFFIX: _trip,
    ".html": _report,
    ".yaml": _tuning,
    ".yml": _tuning,
    ".csv": _trend,
}
