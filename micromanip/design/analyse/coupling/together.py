"""The outer loops as one: what a coupled plant does to loops that were designed each for itself.

With the loops ``l_j`` of the axes alone, the loop of all is ``L = C diag(l)``. Relative gains: Bristol, On a new
measure of interaction, IEEE Trans. Autom. Control 11 (1966). Where the single loops are stable, and nothing that is
not stable hides in C, all together are where ``det(I + L) / prod(1 + l_j) = det(I + (C - I) diag(t))``, with
``t = l / (1 + l)``, does not turn around 0; surely where the Perron root of ``|C - I| diag(|t|)`` is below 1
(Grosdidier and Morari, Interaction measures for systems under decentralized control, Automatica 22, 1986). How much
all loops bear at once, each its own gain or phase, is the multi-loop disk margin (Seiler, Packard, Gahinet, An
introduction to disk margins, IEEE Control Systems 40, 2020), here a lower bound: the structured singular value from
above, by balancing.
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

# The motion y_j of the others comes in as a disturbance of the stage, ``C_ij y_j``, of which the outer loop leaves its
# sensitivity ``S_i``. Decoupling (``rt/laws/decoupling.py``) moves the stage by ``-c_ij G_i (1 + lead s) / g_i`` of it
# ahead, so that
#
#     e_i = -S_i sum_j (C_ij - c_ij G_i e^(-s T) (1 + lead s) / g_i) y_j
#
# is left. The motion is one that was recorded; its spectrum is that of the whole stretch under a Hann window.


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


Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_BALANCED = 12
"""Rounds of balancing; three loops need some ten."""
_UNSURE = 2.0
"""Standard deviations of the coupling by which the bound is widened."""


@dataclass(frozen=True)
class Disk:
    """Gain by which every loop may be wrong, up or down, and phase, all at once."""

    gain_dB: float
    phase_deg: float


@dataclass(frozen=True)
class Together:
    """`interaction`: the Perron root, at worst, with the coupling's uncertainty, at `interaction_Hz`.

    `turns` counts encirclements, over positive and negative frequencies (Nyquist): 0 is stable. `alone` is the margin
    of the single loops without coupling.
    """

    interaction: float
    interaction_Hz: float
    turns: int
    margin: Disk
    alone: Disk

    @property
    def stable(self) -> bool:
        """Whether all loops together are, where each is alone."""
        return self.interaction < 1.0 or self.turns == 0


def relative_gain(share: Complex | Array) -> Complex:
    """Relative gains (n, n, ..) of C (n, n, ..): how much of an axis' own gain is left when the others are controlled.

    It does not change with the gain of any input, so that C says as much as ``C diag(G)``.
    """
    matrices = np.moveaxis(np.asarray(share, dtype=complex), (0, 1), (-2, -1))
    gains = matrices * np.swapaxes(np.linalg.inv(matrices), -2, -1)
    return np.asarray(np.moveaxis(gains, (-2, -1), (0, 1)))


def judge_together(frequency_Hz: Array, share: Complex, deviation: Array, loops: Complex) -> Together:
    """`share` and `deviation` (n, n, k) of a measured coupling, `loops` (n, k) of the axes alone."""
    n = len(loops)
    coupled, sizes = np.moveaxis(share, 2, 0), np.moveaxis(np.abs(share) + _UNSURE * deviation, 2, 0).copy()
    sizes[:, range(n), range(n)] = 0.0
    closed = (loops / (1.0 + loops)).T
    roots = np.abs(np.linalg.eigvals(sizes * np.abs(closed)[:, None, :])).max(axis=1)
    worst = int(np.argmax(roots))
    own = np.eye(n)
    turned = np.linalg.det(own + (coupled - own) * closed[:, None, :])
    angle = np.unwrap(np.angle(turned))
    return Together(
        float(roots[worst]),
        float(frequency_Hz[worst]),
        round(float(angle[-1] - angle[0]) / np.pi),
        disk_margin(coupled * loops.T[:, None, :]),
        disk_margin(own * loops.T[:, None, :]),
    )


def disk_margin(loop: Complex) -> Disk:
    """Symmetric disk margin of `loop` (k, n, n), negative feedback, for each loop's own complex factor."""
    own = np.eye(loop.shape[1])
    sizes = structured(np.asarray(np.linalg.inv(own + loop) - 0.5 * own, dtype=np.complex128))
    alpha = min(1.0 / float(sizes.max()), 2.0)
    gain_dB = 20.0 * np.log10((2.0 + alpha) / (2.0 - alpha)) if alpha < 2.0 else np.inf
    return Disk(float(gain_dB), float(np.degrees(2.0 * np.arctan(0.5 * alpha))))


def structured(matrices: Complex) -> Array:
    """Upper bound (k,) of the structured singular value of `matrices` (k, n, n) for a diagonal of complex numbers.

    The largest singular value after balancing (Osborne, On pre-conditioning of matrices, JACM 7, 1960).
    """
    scaled = np.array(matrices, dtype=complex)
    others = ~np.eye(scaled.shape[1], dtype=bool)
    for _ in range(_BALANCED):
        for i in range(scaled.shape[1]):
            row = np.linalg.norm(scaled[:, i, others[i]], axis=1)
            column = np.linalg.norm(scaled[:, others[i], i], axis=1)
            both = (row > 0.0) & (column > 0.0)
            factor = np.sqrt(np.divide(column, row, out=np.ones_like(row), where=both))[:, None]
            scaled[:, i] *= factor
            scaled[:, :, i] /= factor
    return np.asarray(np.linalg.norm(scaled, 2, axis=(1, 2)))
