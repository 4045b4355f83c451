"""The trip report: what tripped, the order of causes, what the loop did, what to do next; in words."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.faults import BY_NAME, raised
from micromanip.files import open_regular
from micromanip.rt.states import REACTION_NAMES, STATE_NAMES, WARN

from .evidence import Moment, at_end_of_range, error_um, milliseconds, observations, parameters_of
from .store import TripRecord

_MEANING = {
    "READY": "disarmed, outputs at park",
    "ARMING": "arming",
    "TRACKING": "the loops follow the reference",
    "HOLDING": "correction frozen",
    "RAMPING": "smoothly to the park voltage",
    "FAULT": "latched; nothing moves before a reset",
    "OFF": "the loop ends",
}
_BEFORE_MS = -1000.0


def story(box: TripRecord, file: Path) -> dict[str, Any]:
    """The whole explanation as plain data; `lines` makes text of it."""
    trip = box.trip
    kind = next((kind for kind in BY_NAME.values() if kind.code == trip["code"]), None)
    return {
        "trip": file.stem,
        "file": str(file),
        "code": trip["code"],
        "axis": trip["axis"],
        "value": trip["value"],
        "limit": trip["limit"],
        "seen": box.seen,
        "message": trip["message"],
        "utc": box.meta["utc"],
        "cycle": trip["cycle"],
        "complete": box.meta["complete"],
        "cycles": len(box.rows),
        "timeline": [{"ms": round(m.ms, 3), "axis": m.axis, "text": m.text} for m in _timeline(box)],
        "states": [{"ms": round(ms, 3), "state": name} for ms, name in states(box)],
        "axes": {name: _axis(box, i) for i, name in enumerate(box.meta["axes"])},
        "configuration": {
            "path": box.meta["path"],
            "sha256": box.meta["sha256"],
            "now": _present(Path(box.meta["path"]), box.meta["sha256"]),
            "parameter_versions": box.parameters["version"].tolist(),
        },
        "likely_causes": list(kind.likely_causes) if kind else [],
        "next_step": kind.next_step if kind else "",
    }


def states(box: TripRecord) -> list[tuple[float, str]]:
    """Each state of the cell and the time (ms from the trip) at which the rows first show it."""
    if not len(box.rows):
        return []
    state, ms = box.rows["state"], milliseconds(box)
    changes = [0, *(np.flatnonzero(np.diff(state)) + 1).tolist()]
    return [(float(ms[k]), STATE_NAMES[state[k]]) for k in changes]


def _timeline(box: TripRecord) -> list[Moment]:
    """Evidence, faults and warnings, and states; at the same time in this order."""
    changes = [
        Moment(ms, None, f"{name}{'' if k else ' already'}: {_MEANING.get(name, '')}")
        for k, (ms, name) in enumerate(states(box))
    ]
    return sorted([*observations(box), *_raised(box), *changes], key=lambda moment: moment.ms)


def _raised(box: TripRecord) -> list[Moment]:
    """Faults and warnings of the time that the box holds, the trip at 0."""
    trip, moments, told = box.trip, [], False
    for event in box.events:
        code, cycle = int(event["code"]), int(event["cycle"])
        own = code == trip["number"] and cycle == trip["cycle"]
        told |= own
        if len(box.rows) and not box.rows["cycle"][0] - 1 <= cycle <= box.rows["cycle"][-1]:
            continue
        ms = 0.0 if own else (cycle - trip["cycle"]) * box.meta["period_ns"] * 1e-6
        moments.append(_noticed(box, event, ms))
    if not told:
        moments.append(Moment(0.0, trip["axis"], box.seen))
    return moments


def _noticed(box: TripRecord, event: Any, ms: float) -> Moment:
    """One fault or warning; one that this version does not know has its number."""
    report, reaction = raised(event, box.meta["axes"]), int(event["reaction"])
    if report is None:
        return Moment(ms, None, f"event {event['code']}, {event['value']:g} (limit {event['limit']:g})")
    reacted = f" -> {REACTION_NAMES[reaction]}" if reaction != WARN else ""
    return Moment(ms, report.axis, f"{report.kind.code} {report.measured}{reacted}")


def _axis(box: TripRecord, axis: int) -> dict[str, float | list[float] | None]:
    """Where the axis was at the trip: the last cycle before it, in which it was still controlled."""
    if not len(box.rows):
        return {}
    ms, error = milliseconds(box), error_um(box, axis)
    at = max(0, int(np.searchsorted(ms, 0.0)) - 1)
    before = ms <= 0.0
    last_second = before & (ms > _BEFORE_MS)
    limiter, row = parameters_of(box, axis)["limiter"], box.rows["axis"][at, axis]
    known = np.abs(error[before & np.isfinite(error)])
    return {
        "error_um": _number(error[at]),
        "max_error_um": _number(known.max()) if len(known) else None,
        "setpoint_um": _number(row["setpoint_um"]),
        "strain_um": _number(row["strain_um"]),
        "stage_um": _number(row["stage_um"]),
        "voltage_V": _number(row["voltage_V"]),
        "range_V": [float(limiter["low_V"]), float(limiter["high_V"])],
        "saturated_percent": round(100.0 * float(at_end_of_range(box, axis)[last_second].mean()), 1),
    }


def _number(value: Any) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None


def _present(file: Path, sha256: str) -> str:
    """What has become of the configuration's file: unchanged, changed or missing."""
    try:
        with open_regular(file) as stream:
            text = stream.read().decode("utf-8-sig")
    except (OSError, UnicodeDecodeError):
        return "missing"
    return "unchanged" if hashlib.sha256(text.encode()).hexdigest() == sha256 else "changed"


def lines(told: dict[str, Any]) -> list[str]:
    """The story as text, a line each."""
    text = [told["seen"], f"{told['utc']} (cycle {told['cycle']})", ""]
    text += ["What happened, in ms from the trip:"]
    for moment in told["timeline"]:
        where = f"{moment['axis']}: " if moment["axis"] and f"axis {moment['axis']}" not in moment["text"] else ""
        text.append(f"{moment['ms']:10.1f}  {where}{moment['text']}")
    if not told["complete"]:
        text.append("            (what came after is missing: the black box could not be completed)")
    text += ["", "Axes in the last cycle before it:"]
    text += [f"  {name}: {_axis_words(axis)}" for name, axis in told["axes"].items() if axis]
    configuration = told["configuration"]
    now = {
        "unchanged": "the file is the same today",
        "changed": "the file is another one today",
        "missing": "the file is not there any more",
    }[configuration["now"]]
    versions = ", ".join(str(version) for version in configuration["parameter_versions"])
    text += ["", f"Configuration: {configuration['path']}, sha256 {configuration['sha256'][:16]}; {now}"]
    text += [f"Parameter versions in force: {versions}"]
    if told["likely_causes"]:
        text += [f"Likely: {'; or '.join(told['likely_causes'])}"]
    if told["next_step"]:
        text += [f"Next: {told['next_step']}"]
    return [*text, f"Black box: {told['file']}"]


def _axis_words(axis: dict[str, Any]) -> str:
    low, high = axis["range_V"]
    voltage = f"{axis['voltage_V']:.1f} V of {low:g} to {high:g} V"
    if axis["saturated_percent"] > 0:
        voltage += f", at an end of it {axis['saturated_percent']:g} % of the last second"
    if axis["error_um"] is None:
        return voltage
    return f"error {axis['error_um']:.2f} um (largest before {axis['max_error_um']:.2f} um), {voltage}"
