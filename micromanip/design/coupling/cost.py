"""What coupling costs: the path error that the others' motion leaves in an axis, with and without decoupling.

The motion y_j of the others comes in as a disturbance of the stage, ``C_ij y_j``, of which the outer loop leaves its
sensitivity ``S_i``. Decoupling (``rt/laws/decoupling.py``) moves the stage by ``-c_ij G_i (1 + lead s) / g_i`` of it
ahead, so that

    e_i = -S_i sum_j (C_ij - c_ij G_i e^(-s T) (1 + lead s) / g_i) y_j

is left. The motion is one that was recorded; its spectrum is that of the whole stretch under a Hann window.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.control.outer_gains import dc_gain, outer_gains, steady_lag
from micromanip.settings.schema.axis import Outer
from micromanip.settings.schema.model import Configuration

from ..loops import model_system, stage_loop
from .measured import AT_REST_HZ, Coupling

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Cost:
    """Path error of one axis in um rms: of the coupling `ignored`, and what decoupling would leave of that.

    `unsure` is what the coupling's standard deviation makes of the motion; `moved` how far (um, peak) it moves the
    stage without an outer loop.
    """

    ignored: float
    decoupled: float
    unsure: float
    moved: float

    def whole(self, seen_um: float) -> float:
        """The path error that is expected with decoupling where `seen_um` rms were seen without."""
        return float(np.sqrt(max(seen_um**2 - self.ignored**2, 0.0) + self.decoupled**2 + self.unsure**2))


def outer_of(configuration: Configuration, axis: str) -> Outer:
    """The outer loop of `axis`; ValueError where there is none."""
    outer = configuration.axes[axis].outer
    if outer is None:
        raise ValueError(f"axis {axis} has no outer loop")
    return outer


def loop_of(configuration: Configuration, axis: str, hertz: Array, late_cycles: int = 0) -> Complex:
    """Outer loop of `axis` alone, (k,), around its own model; above half the rate of its samples it has no gain."""
    outer, period_s = outer_of(configuration, axis), configuration.loop.period_ns * 1e-9
    plant = model_system(outer.model, period_s)
    loop = stage_loop(outer_gains(outer, None, period_s), plant, outer.sample_cycles, late_cycles)
    inside = hertz < 0.5 / loop.period_s
    return np.asarray(np.where(inside, loop.response(2.0 * np.pi * np.where(inside, hertz, 0.25 / loop.period_s)), 0.0))


def costs(configuration: Configuration, coupling: Coupling, motion_um: Array, rate_hz: float) -> dict[str, Cost]:
    """The cost in each axis of the `motion_um` (m, n) of all, recorded at `rate_hz` while they followed their paths."""
    count = len(motion_um)
    window = np.hanning(count)
    spectrum = np.fft.rfft((motion_um - motion_um.mean(axis=0)) * window[:, None], axis=0)
    power = 2.0 / (count * np.sum(window**2))  # of a line, one-sided: their sum is the mean square (Parseval)
    hertz = np.asarray(np.fft.rfftfreq(count, 1.0 / rate_hz), dtype=np.float64)
    omega, period_s = 2.0 * np.pi * hertz, configuration.loop.period_ns * 1e-9
    found = {}
    for i, axis in enumerate(coupling.axes):
        outer = outer_of(configuration, axis)
        with np.errstate(divide="ignore", invalid="ignore"):
            left = np.nan_to_num(1.0 / (1.0 + loop_of(configuration, axis, np.maximum(hertz, 1e-6))))
        lead_s = (steady_lag(outer) + 1.0) * period_s
        ahead = model_system(outer.model, period_s).response(omega) / dc_gain(outer)
        ahead = ahead * np.exp(-1j * omega * period_s) * (1.0 + 1j * omega * lead_s)
        ignored, decoupled, unsure = (np.zeros(len(hertz), complex) for _ in range(3))
        for j in range(len(coupling.axes)):
            if j == i:
                continue
            share = over(coupling, i, j, hertz)
            ignored += share * spectrum[:, j]
            decoupled += (share - coupling.sure[i, j] * coupling.rest[i, j] * ahead) * spectrum[:, j]
            unsure += np.interp(hertz, coupling.frequency_Hz, coupling.deviation[i, j]) * np.abs(spectrum[:, j])
        others = np.where(np.arange(len(coupling.axes)) == i, 0.0, coupling.rest[i])
        moved_um = (motion_um - motion_um.mean(axis=0)) @ others
        parts = [float(np.sqrt(power * np.sum(np.abs(left * part) ** 2))) for part in (ignored, decoupled, unsure)]
        found[axis] = Cost(parts[0], parts[1], parts[2], float(np.abs(moved_um).max()))
    return found


def over(coupling: Coupling, i: int, j: int, hertz: Array) -> Complex:
    """C_ij at `hertz` (k,): between its lines; as at rest below ``AT_REST_HZ``, and as the last line above them."""
    lines, share = coupling.frequency_Hz, coupling.share[i, j]
    between = np.interp(hertz, lines, share)
    return np.asarray(np.where(hertz <= AT_REST_HZ, coupling.rest[i, j], between))
