"""Whether a closed loop keeps a swing alive: the axis at its working point, with its loops closed and without.

Noise is never measured in a loop that may swing. The strain loop is held against its gauge while the output is held;
the outer loop against the stage while only the strain loop is closed, which passes its gauge's noise on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import detrend, welch

from micromanip.control.system import Array
from micromanip.settings.schema.model import Configuration

from ..experiment import Experiment, alone, play, resting
from .quiescent_spectrum import STANDS_OUT, strongest_line

_REST_S, _SWING_HZ, _WINDOW_S, _LOUDER = 2.0, (3.0, 1000.0), 0.5, 3.0
"""Time at rest, of which the second half counts; where a swing is looked for, in spectra of that length; how much more
than without the loop there may be."""


@dataclass(frozen=True)
class Rest:
    """A sensor at rest, rms: `open_um` without the loop, `closed_um` with it.

    With it a line of `line_um` at `line_Hz` stands out of its neighbours `ratio` times; without it the same line has
    `open_line_um`. A limit cycle is such a line. `step_um` is the sensor's own: a loop may hunt by one.
    """

    open_um: float
    closed_um: float
    line_Hz: float
    line_um: float
    ratio: float
    open_line_um: float
    step_um: float = 0.0

    @property
    def floor_um(self) -> float:
        """Noise that nobody can ask a loop to be below; what the loop itself adds excuses nothing."""
        return min(self.open_um, self.closed_um)

    @property
    def swings(self) -> bool:
        """Whether the loop keeps a swing alive."""
        own = self.ratio > STANDS_OUT and self.line_um > _LOUDER * max(self.open_line_um, self.step_um)
        return own or self.closed_um > _LOUDER * max(self.open_um, self.step_um)

    @property
    def told(self) -> str:
        """Both, in words, with the line."""
        line = f"; a line of {self.line_um:.3g} um at {self.line_Hz:.3g} Hz" if self.ratio > STANDS_OUT else ""
        return f"{self.closed_um:.3f} um rms, {self.open_um:.3f} um without the loop{line}"


@dataclass(frozen=True)
class Seen:
    """A sensor's samples (n,) in um without mean and slope, none where there is no sensor; the smallest step of it."""

    moved_um: Array
    step_um: float

    @classmethod
    def of(cls, um: Array) -> Seen:
        """`um` (n,) as recorded."""
        if not np.isfinite(um).all():
            return cls(np.zeros(0), 0.0)
        steps = np.abs(np.diff(um))
        return cls(np.asarray(detrend(um)), float(steps[steps > 0.0].min(initial=np.inf)) if steps.any() else 0.0)


@dataclass(frozen=True)
class Held:
    """Gauge and stage sensor at the working point; `voltage_V` that was there."""

    strain: Seen
    stage: Seen
    voltage_V: float


def hold(
    configuration: Configuration, experiment: Experiment, axis: str, mode: str, voltage_V: float | None = None
) -> Held:
    """`axis` at its working point in `mode`, in mode voltage at `voltage_V`; the others parked."""
    rate_hz, i = configuration.loop.rate_hz, list(configuration.axes).index(axis)
    samples = resting(configuration, axis, round(_REST_S * rate_hz))
    if voltage_V is not None:
        samples[:, i] = voltage_V
    rows = play(alone(configuration, axis, mode), experiment, samples)[:, i]
    late = rows[len(rows) // 2 :]
    strain, stage = (Seen.of(np.asarray(late[name], dtype=float)) for name in ("strain_um", "stage_um"))
    return Held(strain, stage, float(np.mean(late["voltage_V"])))


def strain_at_rest(configuration: Configuration, experiment: Experiment, axis: str) -> tuple[Rest, Held]:
    """The gauge with the strain loop closed beside the gauge with the output held there; and `axis` in that loop."""
    closed = hold(configuration, experiment, axis, "strain")
    still = hold(configuration, experiment, axis, "voltage", closed.voltage_V)
    return compared(still.strain, closed.strain, configuration.loop.rate_hz), closed


def stage_at_rest(configuration: Configuration, experiment: Experiment, axis: str, inner: Held) -> Rest:
    """The stage with the outer loop closed, beside what its sensor says while `inner`, the strain loop, is alone."""
    closed = hold(configuration, experiment, axis, "stage")
    return compared(inner.stage, closed.stage, configuration.loop.rate_hz)


def compared(still: Seen, closed: Seen, rate_hz: float) -> Rest:
    """One sensor without the loop, `still`, and with it."""
    hertz, size_um, ratio = strongest_line(closed.moved_um, rate_hz, _SWING_HZ, _WINDOW_S)
    before_um = _loudest(still.moved_um, rate_hz, hertz)
    step_um = max(still.step_um, closed.step_um)
    return Rest(float(still.moved_um.std()), float(closed.moved_um.std()), hertz, size_um, ratio, before_um, step_um)


def _loudest(y: Array, rate_hz: float, hertz: float) -> float:
    """Largest amplitude of `y` (n,) in its spectrum near a frequency."""
    if not len(y):
        return 0.0
    at_Hz, power = welch(y, rate_hz, "hann", round(_WINDOW_S * rate_hz), scaling="spectrum")
    near = np.abs(at_Hz - hertz) <= 0.1 * hertz + 2.0 / _WINDOW_S
    return float(np.sqrt(2.0 * power[near].max(initial=0.0)))
