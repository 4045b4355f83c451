"""What a trend says of now and of the last day, for ``micromanip status``, also where no controller runs any more."""

from __future__ import annotations

import contextlib
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micromanip.errors import MicromanipError
from micromanip.status_reply import TrendKept

if TYPE_CHECKING:
    from micromanip.design.trend import LastDay

_OF_THE_SERVICE = Path("/var/lib/micromanip/trend")


def with_last_day(kept: TrendKept) -> dict[str, Any]:
    """With `last_day`: its figures, or None where its files tell none."""
    return {**kept, "last_day": None if (found := _last_day(Path(kept["folder"]))) is None else found._asdict()}


def told(kept: TrendKept) -> str:
    """A line."""
    if kept["message"] is not None:
        return f"trend: {kept['message']}"
    age = "no row yet" if kept["age_s"] is None else f"newest row {kept['age_s']:.1f} s old"
    day = _last_day(Path(kept["folder"]))
    return f"trend: {kept['folder']}, {age}" + ("" if day is None else f"; {_errors(day)}")


def told_of_the_last() -> str | None:
    """What the newest trend says that is known here, where no controller answers; None where none is known."""
    days = [(day, folder) for folder in _known() if (day := _last_day(folder)) is not None]
    if not days:
        return None
    day, folder = max(days, key=lambda each: each[0].ends)
    ended = datetime.fromisoformat(f"{day.ends}+00:00")
    state = day.state if day.fault is None else f"{day.state} with {day.fault}"
    ago = _ago((datetime.now(UTC) - ended).total_seconds())
    return f"the newest trend here, {folder}, ends {ago} ago ({ended:%Y-%m-%d %H:%M} UTC) in {state}; {_errors(day)}"


def _known() -> list[Path]:
    """Folders of trends: this user's, the service's, and that of the newest day in the catalogue."""
    from micromanip.catalogue import FILE
    from micromanip.host.state_directory import state_directory

    own = state_directory()
    folders = [own / "trend", _OF_THE_SERVICE]
    with contextlib.suppress(MicromanipError, OSError):
        if (own / FILE).is_file():
            from micromanip.catalogue.store import Catalogue, Query

            with Catalogue(own / FILE) as catalogue:
                folders += [entry.path.parent for entry in catalogue.find(Query(kind="trend", most=1))]
    return [folder for folder in dict.fromkeys(folders) if folder.is_dir()]


def _last_day(folder: Path) -> LastDay | None:
    from micromanip.design.trend import last_day

    try:
        return last_day(folder)
    except MicromanipError:  # not there yet, or not for this user: `trend` says why
        return None


def _errors(day: LastDay) -> str:
    known = " ".join(f"{axis} {um:.2f}" for axis, um in day.error_um.items() if um is not None)
    error = f"path error {known} um, median of the minutes' rms" if known else "no path error"
    return f"last 24 h, {day.minutes} min of them: {error}"


def _ago(seconds: float) -> str:
    for unit, length_s in (("days", 86_400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length_s:
            return f"{seconds / length_s:.0f} {unit}"
    return f"{max(0.0, seconds):.0f} s"
