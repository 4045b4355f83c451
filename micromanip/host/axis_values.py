"""What each axis does: position, set-point, strain, voltage, headroom, error; latest, last second, last minute.

All of it comes from the telemetry ring, which the loop fills anyway. A value that is not known is none: no sensor, no
sample that is young enough, a loop that is not closed, a controller that does not turn any more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from micromanip.replies import AxisValues, Value
from micromanip.rt.phases import CHECKING_STAGE, CLOSED, LIFTING, SWEEPING
from micromanip.rt.states import STAGE, VOLTAGE

from .controller import Controller
from .windows import DIGITS, Array, Windows

QUANTITIES = ("position_um", "setpoint_um", "strain_um", "voltage_V", "headroom_V", "error_um")
"""In the order of the columns here."""
_SECOND_S, _MINUTE_S = 1.0, 60.0
_SILENT_S = 0.5
"""A loop that has written no row for so long stands still: what it wrote last is no value of now."""
_OLDEST_NS = 2_000_000_000
"""Ages in the ring end here: the sample is at least so old, or never came."""


@dataclass(frozen=True)
class _Known:
    """Quantities of one axis in some rows, and why one of them is unknown in the last row."""

    values: Array
    """(n, quantities), NaN where unknown."""
    unknown: tuple[str | None, ...]


class AxesValues:
    """Follows the axes of one controller, row by row."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._names = list(controller.prepared.configuration.axes)
        self._windows = Windows(len(self._names) * len(QUANTITIES))

    def add(self, rows: Any) -> None:
        """Take in rows of the telemetry ring."""
        if len(rows):
            values = [self._known(i, rows).values for i in range(len(self._names))]
            self._windows.add(rows["time_ns"], np.concatenate(values, axis=1))

    def report(self, latest: Any | None, now_ns: int) -> dict[str, AxisValues]:
        """Figures by axis at `now_ns`, CLOCK_MONOTONIC; `latest` is the newest row of the ring, None without any."""
        second, minute = self._windows.over(_SECOND_S, now_ns), self._windows.over(_MINUTE_S, now_ns)
        report: dict[str, AxisValues] = {}
        for i, name in enumerate(self._names):
            known, first = self._now(i, latest, now_ns), i * len(QUANTITIES)
            position, setpoint, strain, voltage, headroom, error = (
                Value(
                    latest=None if why else round(float(value), DIGITS), unknown=why, second=second[k], minute=minute[k]
                )
                for k, (value, why) in enumerate(zip(known.values[-1], known.unknown, strict=True), first)
            )
            report[name] = AxisValues(
                position_um=position,
                setpoint_um=setpoint,
                strain_um=strain,
                voltage_V=voltage,
                headroom_V=headroom,
                error_um=error,
                error_of=self._error_of(i),
            )
        return report

    def _now(self, i: int, latest: Any | None, now_ns: int) -> _Known:
        if latest is None:
            return _unknown("the loop has not turned yet")
        silent_s = (now_ns - int(latest["time_ns"])) * 1e-9
        if silent_s > _SILENT_S:
            return _unknown(f"stale: the loop has stood still for {silent_s:.1f} s")
        known = self._known(i, latest.reshape(1))
        axis, image = self._axis(i), self._controller.status["signals"]
        hints = {0: _refused(image, axis, "stage"), 2: _refused(image, axis, "strain")}
        return replace(known, unknown=tuple(why and why + hints.get(k, "") for k, why in enumerate(known.unknown)))

    def _axis(self, i: int) -> Any:
        return self._controller.prepared.parameters[0]["axis"][i]

    def _error_of(self, i: int) -> str | None:
        """What the error is: of the path at the spindle, of the gauge behind its set-point, None in open loop."""
        axis = self._axis(i)
        if axis["path_error"] >= 0 or axis["mode"] == STAGE:
            return "path"
        return None if axis["mode"] == VOLTAGE else "gauge"

    def _known(self, i: int, rows: Any) -> _Known:
        """Quantities of axis `i` in `rows`."""
        axis, name, row, phase = self._axis(i), self._names[i], rows["axis"][:, i], rows["phase"]
        position, no_position = _sample(row, "stage", f"stage_{name}", axis["stage"], axis["stage_age_ns"])
        strain, no_strain = _sample(row, "strain", f"strain_{name}", axis["strain"], axis["strain_age_ns"])
        drives = np.isin(phase, (LIFTING, CHECKING_STAGE, SWEEPING, CLOSED)) & (axis["mode"] != VOLTAGE)
        setpoint = np.where(drives, row["setpoint_um"], np.nan)
        voltage = row["voltage_V"]
        headroom = np.minimum(voltage - axis["limiter"]["low_V"], axis["limiter"]["high_V"] - voltage)
        kind = self._error_of(i)
        closed = (phase == CLOSED) & (kind is not None)
        if kind == "path":  # the simulation's truth needs no sensor
            seen = np.isfinite(position) | (axis["path_error"] >= 0)
            error = np.where(closed & seen, row["path_error_um"], np.nan)
        else:
            error = np.where(closed, setpoint - strain, np.nan)
        idle = "open loop: mode voltage" if axis["mode"] == VOLTAGE else "loops open"
        why = (
            no_position,
            None if drives[-1] else idle,
            no_strain,
            None,
            None,
            (no_position if kind == "path" else no_strain) if closed[-1] else idle,
        )
        values = np.stack([position, setpoint, strain, voltage, headroom, error], axis=1)
        last = zip(np.isfinite(values[-1]), why, strict=True)
        return _Known(values, tuple(None if known else text or "not a number" for known, text in last))


def _sample(row: Any, role: str, signal: str, place: int, longest_ns: int) -> tuple[Array, str | None]:
    """A sensor's values, NaN where there is none that is young enough; and why the last one is unknown."""
    age_ns = row[f"{role}_age_ns"]
    stale = (age_ns > longest_ns) | (age_ns >= _OLDEST_NS)
    if place < 0:
        return np.full(len(row), np.nan), f"no signal {signal}"
    last_ns = int(age_ns[-1])
    old = "2 s or more" if last_ns >= _OLDEST_NS else f"{last_ns * 1e-6:.3g} ms"
    return np.where(stale, np.nan, row[f"{role}_um"]), f"stale: no usable sample of {signal} for {old}"


def _refused(image: Any, axis: Any, role: str) -> str:
    """What the sensor's reading has against it; `image` has the signals as their drivers left them."""
    reading, (low, high) = image[axis[role]], axis[f"{role}_range_um"]
    if axis[role] < 0 or reading["sequence"] == 0:
        return ""
    if reading["status"] != 0:
        return f"; it reads {reading['value']:.4g}, and its driver says that this is no good"
    return "" if low <= reading["value"] <= high else f"; it reads {reading['value']:.4g}, outside {low:g} to {high:g}"


def _unknown(why: str) -> _Known:
    return _Known(np.full((1, len(QUANTITIES)), np.nan), (why,) * len(QUANTITIES))
