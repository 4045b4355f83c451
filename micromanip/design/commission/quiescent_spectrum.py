"""What acts on the cell while nobody moves it: the tracker's rate and noise, and the line that a turning tool leaves.

Recorded in open loop at the park voltages, before anything is closed; best while the spindle cuts air. At its park
voltage a stage may stand at the end of its sensor's range, which shows no line: then an axis looks for it once more
where it works, its strain loop closed by then.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from micromanip.control.system import Array
from micromanip.rt.telemetry import DEVIATION_FRESH, STAGE_FRESH
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker

from ..experiment import Experiment, alone, open_loop, parked, play, resting
from ..identify.network.fit import white_noise

REST_S, AT_WORK_S = 10.0, 8.0
_LEAST = 300
_WINDOW_S, _JOINTS_WINDOW_S = 1.0, 2.5
_TOOTH_HZ, _BESIDE_HZ, _HUM_HZ = (70.0, 1000.0), (2.0, 12.0), (50.0, 60.0, 100.0, 120.0)
"""Where a tooth is looked for, where its neighbours are, and what is taken for the mains."""
STANDS_OUT = 10.0
"""A line's amplitude in terms of its neighbours'."""
FLANK_SHARE = 0.005
"""How far to either side a line may spread, in terms of its frequency: the spindle wanders by a quarter of a percent.
Behind that it must have fallen; a resonance with a damping ratio above .005 has not."""
_JOINTS_HZ, _JOINTS_STAND_OUT = (3.0, 30.0), 5.0


@dataclass(frozen=True)
class AtRest:
    """The tracker (rate, noise, the robot's own oscillation), and the tooth's line (Hz, um); None: not found.

    `deviation_um` are the tracker's samples (n,) of each axis that had some.
    """

    tracker_Hz: float | None
    tracker_noise_um: float
    joints_Hz: float | None
    tooth_Hz: float | None
    tooth_um: float = 0.0
    deviation_um: Mapping[str, Array] = field(default_factory=dict, repr=False, compare=False)

    def reference(self) -> Tracker:
        """The tracker as it was seen; what was not seen keeps its default."""
        seen = {
            "sample_rate_Hz": self.tracker_Hz,
            "oscillation_Hz": self.joints_Hz,
            "noise_um": float(f"{max(self.tracker_noise_um, 1e-3):.3g}"),
        }
        return Tracker(source="signal").model_copy(update={n: value for n, value in seen.items() if value is not None})


def look_at_rest(configuration: Configuration, experiment: Experiment) -> AtRest:
    """Record `REST_S` of every axis in open loop and find what is told above."""
    rate_hz, count = configuration.loop.rate_hz, len(configuration.axes)
    rows = play(open_loop(configuration), experiment, parked(configuration, round(REST_S * rate_hz)))[:, :count]
    tooth_Hz, tooth_um, clearest = None, 0.0, STANDS_OUT
    tracker_Hz, joints_Hz, heard, seen = None, None, _JOINTS_STAND_OUT, {}
    for i, name in enumerate(configuration.axes):
        found, size_um, ratio = _tooth_line(rows[:, i], rate_hz)
        if ratio > clearest:
            tooth_Hz, tooth_um, clearest = found, size_um, ratio
        deviation, deviation_Hz = _samples(rows[:, i], "deviation_um", DEVIATION_FRESH, rate_hz)
        if len(deviation) >= _LEAST:
            tracker_Hz = float(f"{deviation_Hz:.3g}")
            seen[name] = deviation
            found, _, ratio = strongest_line(deviation, deviation_Hz, _JOINTS_HZ, _JOINTS_WINDOW_S)
            if ratio > heard:
                joints_Hz, heard = found, ratio
    noise_um = max((white_noise(deviation) for deviation in seen.values()), default=0.0)
    return AtRest(tracker_Hz, noise_um, joints_Hz, tooth_Hz, tooth_um, seen)


def tooth_at_work(configuration: Configuration, experiment: Experiment, axis: str) -> tuple[float, float] | None:
    """Frequency (Hz) and amplitude (um) of the tooth's line while `axis` is held where it works; None: there is none.

    Its strain loop is closed, the outer one is not, and the others are parked.
    """
    rate_hz, index = configuration.loop.rate_hz, list(configuration.axes).index(axis)
    held, samples = alone(configuration, axis, "strain"), resting(configuration, axis, round(AT_WORK_S * rate_hz))
    found, size_um, ratio = _tooth_line(play(held, experiment, samples)[:, index], rate_hz)
    return (found, size_um) if ratio > STANDS_OUT else None


def _tooth_line(rows: NDArray[Any], rate_hz: float) -> tuple[float, float, float]:
    """Frequency (Hz) and amplitude (um) of the strongest line of the stage, and how far it stands out."""
    stage, stage_Hz = _samples(rows[len(rows) // 2 :], "stage_um", STAGE_FRESH, rate_hz)
    if len(stage) < _LEAST:
        return 0.0, 0.0, 0.0
    return strongest_line(stage, stage_Hz, _TOOTH_HZ, flank_share=FLANK_SHARE)


def _samples(rows: NDArray[Any], column: str, fresh: int, rate_hz: float) -> tuple[Array, float]:
    """A sensor's samples, evenly spaced, and their rate (Hz); none where there is no sensor."""
    moments = np.flatnonzero((rows["fresh"] & fresh) != 0)
    if len(moments) < _LEAST:
        return np.zeros(0), rate_hz
    spacing = int(np.median(np.diff(moments)))
    values = np.asarray(rows[column][moments[0] :: spacing], dtype=float)
    return values if np.isfinite(values).all() else values[:0], rate_hz / spacing


def strongest_line(
    y: Array,
    rate_hz: float,
    band_Hz: tuple[float, float],
    window_s: float = _WINDOW_S,
    flank_share: float | None = None,
) -> tuple[float, float, float]:
    """The line in `y` (n,) that stands out most within `band_Hz`: frequency (Hz), amplitude, how far it stands out.

    By Welch's averaged periodogram; the frequency is between the bins, by the parabola through three of them. A broad
    resonance is as wide as its neighbours and does not stand out. A narrow one does; with `flank_share` the line must
    stand out of its own flanks too, from that share of its frequency (a bin at least) to twice as far and two bins.
    """
    hertz, power = welch(y, rate_hz, "hann", round(window_s * rate_hz), scaling="spectrum")
    size = np.sqrt(2.0 * power)
    near, far = (round(each * window_s) for each in _BESIDE_HZ)
    best = (0.0, 0.0, 0.0)
    inside = np.flatnonzero((hertz >= band_Hz[0]) & (hertz <= min(band_Hz[1], 0.4 * rate_hz)))
    for k in inside[1:-1]:
        if size[k] < size[k - 1] or size[k] < size[k + 1] or any(abs(hertz[k] - hum) < 1.5 for hum in _HUM_HZ):
            continue
        around = _beside(size, k, near, far)
        if flank_share is not None:
            flank = max(1, round(flank_share * hertz[k] * window_s))
            around = max(around, _beside(size, k, flank, 2 * flank + 2))
        ratio = float(size[k] / max(around, 1e-12))
        if ratio > best[2]:
            low, middle, high = np.log(np.maximum(size[k - 1 : k + 2], 1e-12))
            bend = low - 2.0 * middle + high
            moved = 0.5 * (low - high) / bend if bend < 0.0 else 0.0
            best = float(f"{hertz[k] + moved / window_s:.4g}"), float(size[k]), ratio
    return best


def _beside(size: Array, k: int, near: int, far: int) -> float:
    """Median of `size` (n,) on both sides of bin `k`, more than `near` and at most `far` bins away."""
    below, above = size[max(k - far, 1) : max(k - near, 2)], size[k + near + 1 : k + far + 1]
    return float(np.median(np.concatenate([below, above])))
