"""The trip report: what tripped, the order of causes, what the loop did, what to do next; in words and as a picture."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from micromanip.faults import BY_NAME, raised
from micromanip.files import open_regular
from micromanip.rt import states as states_of
from micromanip.rt.states import REACTION_NAMES, STATE_NAMES, WARN

from .evidence import Moment, at_end_of_range, error_um, milliseconds, observations, parameters_of
from .store import TripRecord

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MEANING = {
    "READY": "disarmed, outputs at park",
    "ARMING": "arming",
    "TRACKING": "the loops follow the reference",
    "HOLDING": "correction frozen",
    "RAMPING": "smoothly to the park voltage",
    "FAULT": "latched; nothing moves before a reset",
    "OFF": "the loop ends",
}
_SENSORS = {
    states_of.STRAIN_INVALID: "strain",
    states_of.STRAIN_SILENT: "strain",
    states_of.STRAIN_STUCK: "strain",
    states_of.STRAIN_CHECK: "strain",
    states_of.STAGE_INVALID: "stage",
    states_of.STAGE_STUCK: "stage",
    states_of.STAGE_CHECK: "stage",
    states_of.DISAGREEMENT: "stage",
    states_of.STAGE_DRIFT: "stage",
}
"""Faults of a sensor: the picture shows what it said."""
_FRESH, _WORDS = {"strain": 1, "stage": 2}, {"strain": "gauge", "stage": "stage sensor"}
_BEFORE_MS = -1000.0
_SIZE, _DPI = (12.0, 8.0), 130
_NEAR_MS, _SHORTLY_MS = (-50.0, 50.0), 5.0
_SHADES = {
    "READY": "white",
    "ARMING": "tab:olive",
    "TRACKING": "tab:green",
    "HOLDING": "tab:orange",
    "RAMPING": "gold",
    "FAULT": "tab:red",
    "OFF": "tab:grey",
}


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


def save(box: TripRecord, file: Path) -> None:
    """Draw the trip into a PNG or SVG file."""
    _drawn(box).savefig(file, dpi=_DPI, metadata={"Date": None} if file.suffix == ".svg" else None)


def _drawn(box: TripRecord) -> Figure:
    """Errors, voltages with their range, and a sensor that tripped: of the whole time, and near the trip."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE, layout="constrained")
    where = f" axis {box.trip['axis']}" if box.trip["axis"] else ""
    figure.suptitle(f"{box.trip['code']}{where}  {box.meta['utc']}")
    figure.supxlabel(f"{box.meta['path']} ({box.meta['sha256'][:8]})", fontsize="x-small", color="dimgrey")
    sensor = _SENSORS.get(box.trip["number"]) if box.trip["axis"] in box.meta["axes"] else None
    panels = figure.subplots(2 if sensor is None else 3, 2, sharex="col")
    ms = milliseconds(box)
    spans = (float(ms[0]), float(ms[-1])), (max(float(ms[0]), _NEAR_MS[0]), min(float(ms[-1]), _NEAR_MS[1]))
    for column, span in zip(panels.T, spans, strict=True):
        column[0].set_ylabel("error, um")
        column[1].set_ylabel("voltage, V")
        column[-1].set_xlabel("time from the trip, ms")
        column[0].set_xlim(*span)
        for panel in column:
            _shade(panel, box, span)
            panel.axvline(0.0, color="tab:red", lw=1.0)
            panel.grid(alpha=0.3)
        worst_um = 0.0
        for i, name in enumerate(box.meta["axes"]):
            error = error_um(box, i)
            column[0].plot(ms, error, lw=0.8, color=f"C{i}", label=name)
            column[1].plot(ms, box.rows["axis"]["voltage_V"][:, i], lw=0.8, color=f"C{i}")
            for end in (parameters_of(box, i)["limiter"][name] for name in ("low_V", "high_V")):
                column[1].axhline(end, color=f"C{i}", lw=0.8, ls="--")
            before = np.abs(error[(ms >= span[0]) & (ms <= _SHORTLY_MS)])
            worst_um = max(worst_um, float(np.max(before, initial=0.0, where=np.isfinite(before))))
        if worst_um > 0.0:  # what the ramp leaves behind may run out of it
            column[0].set_ylim(-1.2 * worst_um, 1.2 * worst_um)
        if sensor is not None:
            _draw_sensor(column[2], box, sensor)
    panels[0, 0].legend(loc="upper left", fontsize="small", title="axis")
    return figure


def _draw_sensor(panel: Any, box: TripRecord, sensor: str) -> None:
    """What the sensor of the axis that tripped said, each fresh sample a dot, beside what it should have said."""
    row, ms = box.rows["axis"][:, box.meta["axes"].index(box.trip["axis"])], milliseconds(box)
    fresh = row["fresh"] & _FRESH[sensor] != 0
    wanted = "setpoint_um" if sensor == "strain" else "reference_um"
    panel.plot(ms, row[f"{sensor}_um"], lw=0.8, label=f"{_WORDS[sensor]} {box.trip['axis']}")
    panel.plot(ms[fresh], row[f"{sensor}_um"][fresh], ".", ms=2, color="C0")
    panel.plot(ms, row[wanted], "--", lw=0.8, label=wanted.removesuffix("_um"))
    panel.set_ylabel(f"{_WORDS[sensor]}, um")
    panel.legend(loc="upper left", fontsize="small")


def _shade(panel: Any, box: TripRecord, span: tuple[float, float]) -> None:
    """States as coloured stretches with their names, where there is room for one."""
    begun = states(box)
    for (begin, name), end in zip(begun, [*(ms for ms, _ in begun[1:]), span[1]], strict=True):
        left, right = max(begin, span[0]), min(end, span[1])
        if right > left:
            panel.axvspan(left, right, color=_SHADES.get(name, "white"), alpha=0.15, lw=0)
        if right - left > 0.1 * (span[1] - span[0]):
            place = {"xycoords": ("data", "axes fraction"), "ha": "center", "va": "top", "fontsize": "x-small"}
            panel.annotate(name, ((left + right) / 2, 0.97), **place)
