"""What each axis does: position, set-point, strain, voltage, headroom, error; latest, last second, last minute.

All of it comes from the telemetry ring, which the loop fills anyway. A value that is not known is none: no sensor, no
sample that is young enough, a loop that is not closed, a controller that does not turn any more.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.laws.reference import SIGNAL
from micromanip.rt.states import ARMING, CHECKING_STAGE, CLOSED, LIFTING, PHASE_NAMES, STAGE, SWEEPING, VOLTAGE
from micromanip.status_reply import NO_SIGNAL, AxisValues, Value, Window

from .controller import Controller
from .swing import Swings

_QUANTITIES = ("position_um", "setpoint_um", "strain_um", "voltage_V", "headroom_V", "error_um")
"""In the order of the columns here."""
_JOINTS = ("joint_1_Hz", "joint_2_Hz", "joint_3_Hz")
_SECOND_S, _MINUTE_S = 1.0, 60.0
_SILENT_S = 0.5
"""A loop that has written no row for so long stands still: what it wrote last is no value of now."""
_OLDEST_NS = 2_000_000_000
"""Ages in the ring end here: the sample is at least so old, or never came."""


_NO_NUMBER = "not a finite number"
_DRIVES = np.isin(np.arange(len(PHASE_NAMES)), (LIFTING, CHECKING_STAGE, SWEEPING, CLOSED))
"""By the phase: whether the set-point moves the axis."""
BLOCK_NS = 100_000_000
_BLOCKS = 600
"""A minute."""

DIGITS = 5
"""Ten picometres, or 10 uV."""
Array = NDArray[np.float64]


class Windows:
    """Figures of the last second and minute of `columns` quantities, in memory that does not grow.

    A value that is not finite is unknown, and counts nowhere. Values are summed up in blocks of a tenth of a second. A
    window is the blocks that end with the present one, so the oldest values leave it a block at a time.
    """

    def __init__(self, columns: int) -> None:
        self._block = np.full(_BLOCKS, -1, np.int64)
        """Number of the block, its time over its length, that each place holds."""
        self._counts = np.zeros((_BLOCKS, columns), np.int64)
        self._sums, self._squares = np.zeros((2, _BLOCKS, columns))
        self._low, self._high = np.zeros((2, _BLOCKS, columns))

    def add(self, time_ns: NDArray[np.int64], values: Array) -> None:
        """Take in `values` (n, columns) of the rising times `time_ns` (n)."""
        if not len(time_ns):
            return
        numbers = time_ns // BLOCK_NS
        starts = np.r_[0, np.flatnonzero(np.diff(numbers)) + 1]
        known = np.isfinite(values)
        finite = np.where(known, values, 0.0)
        added = (
            np.add.reduceat(known.astype(np.int64), starts),
            np.add.reduceat(finite, starts),
            np.add.reduceat(finite * finite, starts),
            np.minimum.reduceat(np.where(known, values, np.inf), starts),
            np.maximum.reduceat(np.where(known, values, -np.inf), starts),
        )
        for number, count, total, squares, low, high in zip(numbers[starts], *added, strict=True):
            k = number % _BLOCKS
            if self._block[k] != number:
                self._block[k] = number
                self._counts[k] = self._sums[k] = self._squares[k] = 0
                self._low[k], self._high[k] = np.inf, -np.inf
            self._counts[k] += count
            self._sums[k] += total
            self._squares[k] += squares
            self._low[k] = np.minimum(self._low[k], low)
            self._high[k] = np.maximum(self._high[k], high)

    def over(self, seconds: float, now_ns: int) -> list[Window | None]:
        """Figures of each column over the last `seconds` before `now_ns`; None where nothing was known."""
        last = now_ns // BLOCK_NS
        inside = (self._block > last - round(seconds * 1e9 / BLOCK_NS)) & (self._block <= last)
        counts = self._counts[inside]
        totals = zip(
            counts.sum(0).tolist(),
            np.count_nonzero(counts, axis=0).tolist(),
            self._sums[inside].sum(0).tolist(),
            self._squares[inside].sum(0).tolist(),
            self._low[inside].min(0, initial=np.inf).tolist(),
            self._high[inside].max(0, initial=-np.inf).tolist(),
            strict=True,
        )
        return [_window(*each) for each in totals]


def _window(count: int, blocks: int, total: float, squares: float, least: float, most: float) -> Window | None:
    if count == 0:
        return None
    mean, square = total / count, squares / count
    return {
        "seconds": round(blocks * BLOCK_NS * 1e-9, 1),
        "mean": round(mean, DIGITS),
        "min": round(least, DIGITS),
        "max": round(most, DIGITS),
        "rms": round(math.sqrt(square), DIGITS),
        "peak": round(max(abs(least), abs(most)), DIGITS),
        "deviation_rms": round(math.sqrt(max(0.0, square - mean * mean)), DIGITS),
        "deviation_peak": round(max(most - mean, mean - least), DIGITS),
    }


class AxesValues:
    """Follows the axes of one controller, row by row."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._names = list(controller.prepared.configuration.axes)
        self._windows = Windows(len(self._names) * len(_QUANTITIES))
        self._swings = Swings(len(self._names))

    def add(self, rows: Any) -> None:
        """Take in rows of the telemetry ring."""
        values = _known(rows, self._parameters).reshape(len(rows), len(self._names) * len(_QUANTITIES))
        self._windows.add(rows["time_ns"], values)
        self._swings.add(rows)

    def report(self, latest: Any | None, now_ns: int) -> dict[str, AxisValues]:
        """Figures by axis at `now_ns`, CLOCK_MONOTONIC; `latest` is the newest row of the ring, None without any."""
        windows = zip(self._windows.over(_SECOND_S, now_ns), self._windows.over(_MINUTE_S, now_ns), strict=True)
        report: dict[str, AxisValues] = {}
        for i, (name, axis) in enumerate(self._controller.prepared.configuration.axes.items()):
            position, setpoint, strain, voltage, headroom, error = (
                Value(latest=value, unknown=why, second=second, minute=minute)
                for (value, why), (second, minute) in zip(self._now(i, latest, now_ns), windows, strict=False)
            )
            report[name] = AxisValues(
                position_um=position,
                setpoint_um=setpoint,
                strain_um=strain,
                voltage_V=voltage,
                headroom_V=headroom,
                error_um=error,
                error_of=_error_of(self._parameters[i]),
                tooth_Hz=_found_Hz(i, latest, "tooth_Hz"),
                joints_Hz=[_found_Hz(i, latest, joint) for joint in _JOINTS[: self._oscillations(i)]],
                untuned=axis.untuned,
                less=axis.commissioned.less if axis.commissioned else None,
                swing=self._swings.of(i, axis.mode == "stage", float(np.ptp(axis.setpoint.range_um))),
            )
        return report

    @property
    def _parameters(self) -> Any:
        """Parameters of the axes (n) that are in force."""
        return self._controller.prepared.parameters[0]["axis"][: len(self._names)]

    def _oscillations(self, i: int) -> int:
        """How many of the joints' oscillations the predictor of axis `i` knows."""
        reference = self._parameters[i]["reference"]
        return int(reference["modes"]) if reference["kind"] == SIGNAL and reference["predict"] else 0

    def _now(self, i: int, latest: Any | None, now_ns: int) -> list[tuple[float | None, str | None]]:
        """Each quantity of axis `i`, or None and why it is not known."""
        if latest is None:
            return [(None, "the loop has not turned yet")] * len(_QUANTITIES)
        silent_s = (now_ns - int(latest["time_ns"])) * 1e-9
        if silent_s > _SILENT_S:
            return [(None, f"stale: the loop has stood still for {silent_s:.1f} s")] * len(_QUANTITIES)
        values = _known(latest.reshape(1), self._parameters)[0, i]
        if np.isfinite(values).all():
            return [(round(float(value), DIGITS), None) for value in values]
        reasons = self._reasons(i, latest)
        return [
            (round(float(value), DIGITS), None) if np.isfinite(value) else (None, why)
            for value, why in zip(values, reasons, strict=True)
        ]

    def _reasons(self, i: int, row: Any) -> tuple[str, ...]:
        """Why each quantity of axis `i` may be unknown in `row`."""
        axis, name = self._parameters[i], self._names[i]
        stage, strain = (self._no_sample(axis, row["axis"][i], role, f"{role}_{name}") for role in ("stage", "strain"))
        idle = "open loop: mode voltage" if axis["mode"] == VOLTAGE else "loops open"
        closed = row["phase"] == CLOSED and row["state"] != ARMING
        sensor = stage if _error_of(axis) == "path" else strain
        error = sensor if closed and axis["mode"] != VOLTAGE else idle
        return stage, idle, strain, _NO_NUMBER, _NO_NUMBER, error

    def _no_sample(self, axis: Any, row: Any, role: str, signal: str) -> str:
        """Why there is no sample of a sensor that counts; what it reads, where that is the reason."""
        if axis[role] < 0:
            return f"{NO_SIGNAL} {signal}"
        age_ns = int(row[f"{role}_age_ns"])
        why = f"for {'2 s or more' if age_ns >= _OLDEST_NS else f'{age_ns * 1e-6:.3g} ms'}"
        reading, (low, high) = self._controller.status["signals"][axis[role]], axis[f"{role}_range_um"]
        if reading["sequence"] != 0 and reading["status"] != 0:
            why += f"; it reads {reading['value']:.4g}, and its driver says that this is no good"
        elif reading["sequence"] != 0 and not low <= reading["value"] <= high:
            why += f"; it reads {reading['value']:.4g}, outside {low:g} to {high:g}"
        return f"stale: no usable sample of {signal} {why}"


def _found_Hz(i: int, latest: Any | None, name: str) -> float | None:
    """Frequency at which axis `i` has found the tooth, or a joint; None where it does not look for it."""
    hertz = np.nan if latest is None else float(latest["axis"][name][i])
    return round(hertz, DIGITS) if np.isfinite(hertz) else None


def _error_of(axis: Any) -> str | None:
    """What the error of an axis is: of the path at the spindle, of the gauge at its set-point, None in open loop."""
    if axis["path_error"] >= 0 or axis["mode"] == STAGE:
        return "path"
    return None if axis["mode"] == VOLTAGE else "gauge"


def _known(rows: Any, axes: Any) -> Array:
    """Quantities (rows, axes, quantities) of telemetry rows, NaN where one is not known; `axes` are parameters."""
    row, phase = rows["axis"][:, : len(axes)], rows["phase"][:, None]
    loops = axes["mode"] != VOLTAGE
    closed = (phase == CLOSED) & loops & (rows["state"][:, None] != ARMING)  # until its feedback has faded in
    voltage = row["voltage_V"]
    values = np.empty((*row.shape, len(_QUANTITIES)))
    position, setpoint, strain, _, _, error = (values[:, :, k] for k in range(len(_QUANTITIES)))
    position[:] = np.where(_is_young(row, axes, "stage"), row["stage_um"], np.nan)
    strain[:] = np.where(_is_young(row, axes, "strain"), row["strain_um"], np.nan)
    setpoint[:] = np.where(_DRIVES[phase] & loops, row["setpoint_um"], np.nan)
    values[:, :, 3] = voltage
    values[:, :, 4] = np.minimum(voltage - axes["limiter"]["low_V"], axes["limiter"]["high_V"] - voltage)
    of_path = (axes["path_error"] >= 0) | (axes["mode"] == STAGE)
    seen = np.isfinite(position) | (axes["path_error"] >= 0)  # the simulation's truth needs no sensor
    error[:] = np.where(of_path, np.where(seen, row["path_error_um"], np.nan), setpoint - strain)
    error[~closed] = np.nan
    return values


def _is_young(row: Any, axes: Any, role: str) -> Any:
    age_ns = row[f"{role}_age_ns"]
    return (age_ns <= axes[f"{role}_age_ns"]) & (age_ns < _OLDEST_NS) & (axes[role] >= 0)
