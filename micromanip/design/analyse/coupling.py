"""The outer loops as one: what a coupled plant does to loops that were designed each for itself.

With the loops ``l_j`` of the axes alone, the loop of all is ``L = C diag(l)``. Relative gains: Bristol, On a new
measure of interaction, IEEE Trans. Autom. Control 11 (1966). Where the single loops are stable, and nothing that is
not stable hides in C, all together are where ``det(I + L) / prod(1 + l_j) = det(I + (C - I) diag(t))``, with
``t = l / (1 + l)``, does not turn around 0; surely where the Perron root of ``|C - I| diag(|t|)`` is below 1
(Grosdidier and Morari, Interaction measures for systems under decentralized control, Automatica 22, 1986).

Coupling of the axes, measured: each in turn is moved, with all strain loops closed, and every sensor is looked at.

    C_ij = Y_i / Y_j     while axis j alone is moved,

so that the plant of all outer loops is ``C diag(G_jj)`` with the stages' own responses G_jj. Hysteresis and creep of
the axis that is moved are in both Y, and so are not in C. The standard deviation is that of what differs from period to
period (``response/measured.py``); at rest it is that of the mean over the lowest lines, or their scatter if more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.control.outer_gains import dc_gain, outer_gains, steady_lag
from micromanip.control.stage_loop import model_system, stage_loop
from micromanip.control.system import Array, Complex
from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import Outer
from micromanip.settings.schema.model import Configuration

from ..experiment import Experiment, parked, path_bandwidth, play, with_axes, within_slew
from ..identify.response import Measured, Multisine, measure, multisine

AT_REST_HZ = 5.0
"""Up to here a stage answers as at rest."""
_RMS_UM = ((5.0, 1.5), (30.0, 1.0), (150.0, 0.7), (300.0, 1.0))
"""Upper frequency and rms of each part of the set-point's excitation; above, the outer loops have no gain left."""
_LOW_HZ, _LEAD_S, _SLEW_SHARE = 0.3, 1.0, 0.7
_LEAST = 1e-6
"""Standard deviation below which none is believed."""
_SURE = 3.0
"""Standard deviations beyond which a share is one."""
_SURE_OF_MANY = 5.0
"""The same where hundreds of lines are looked at: one of them is always far out."""


@dataclass(frozen=True)
class Coupling:
    """C and its standard deviation, (n, n, k) at the frequencies (k,); row i sees, column j moves; 1 on the diagonal.

    `rest` (n, n) and its deviation are those at rest, `gauge` and its deviation the same of the strain gauges.
    """

    axes: tuple[str, ...]
    frequency_Hz: Array
    share: Complex
    deviation: Array
    rest: Array
    rest_deviation: Array
    gauge: Array
    gauge_deviation: Array

    @property
    def sure(self) -> NDArray[np.bool_]:
        """Which shares at rest (n, n) are beyond their uncertainty; none of the diagonal."""
        return np.asarray((np.abs(self.rest) > _SURE * self.rest_deviation) & ~np.eye(len(self.axes), dtype=bool))

    @property
    def sure_size(self) -> Array:
        """|C| (n, n, k) where it is beyond its uncertainty, else 0."""
        size = np.abs(self.share)
        return np.asarray(np.where(size > _SURE_OF_MANY * self.deviation, size, 0.0))

    @property
    def largest(self) -> tuple[float, float, str, str]:
        """The largest |C_ij| over frequency: its size, where (Hz), the axis that sees it, and the one that moves."""
        size = self.sure_size.copy()
        size[range(len(self.axes)), range(len(self.axes))] = 0.0
        i, j, k = np.unravel_index(int(np.argmax(size)), size.shape)
        return float(size[i, j, k]), float(self.frequency_Hz[k]), self.axes[i], self.axes[j]


def measure_coupling(configuration: Configuration, experiment: Experiment, seed: int) -> Coupling:
    """Move each axis of `configuration`, all of which are tuned; the others are held at their working points.

    Raises CheckFailed where a sensor has gaps.
    """
    names, rate_hz = tuple(configuration.axes), float(configuration.loop.rate_hz)
    band = min(path_bandwidth(experiment.path(configuration, name), configuration.loop.rate_hz) for name in names)
    cutoff_Hz = min(_RMS_UM[-1][0], 0.4 * rate_hz, band)
    held = with_axes(configuration, mode="strain", actuator=None)
    seen: list[tuple[list[Measured], list[Measured]]] = []
    for j in range(len(names)):
        wave = multisine(_RMS_UM, _LOW_HZ, cutoff_Hz, rate_hz, seed=seed + j, lead_s=_LEAD_S, periods=3, draws=1)
        seen.append(_moved(held, experiment, j, wave))
    return assembled(names, [stages for stages, _ in seen], [gauges for _, gauges in seen])


def _moved(
    held: Configuration, experiment: Experiment, j: int, wave: Multisine
) -> tuple[list[Measured], list[Measured]]:
    """Each stage, and each gauge, in terms of that of axis number `j`, which is moved."""
    axes = list(held.axes.values())
    samples = parked(held, len(wave.samples))
    samples[:, : len(axes)] = [axis.centre_um for axis in axes]
    samples[:, j] += within_slew(held, list(held.axes)[j], wave.samples, _SLEW_SHARE)
    rows = play(held, experiment, samples)
    found = []
    for role in ("stage_um", "strain_um"):
        moved = np.asarray(rows[role][:, : len(axes)], dtype=float)
        if not np.isfinite(moved).all():
            gone = list(held.axes)[int(np.argmin(np.isfinite(moved).all(axis=0)))]
            raise CheckFailed(f"axis {gone}: {role} has gaps in the record of the coupling; look at its cable")
        found.append([_itself(wave) if i == j else measure(wave, moved[:, j], moved[:, i]) for i in range(len(axes))])
    return found[0], found[1]


def _itself(wave: Multisine) -> Measured:
    """What an axis sees of itself: all, for sure."""
    ones, none = np.ones(len(wave.lines)), np.zeros(len(wave.lines))
    return Measured(wave.frequency_Hz, ones.astype(complex), ones.astype(complex)[None], none, none)


def assembled(axes: tuple[str, ...], stages: list[list[Measured]], gauges: list[list[Measured]]) -> Coupling:
    """The whole of it, of what was seen by each axis, [moved][seen]."""
    hertz = stages[0][0].frequency_Hz
    share, deviation = (
        np.array([[getattr(column[i], name) for column in stages] for i in range(len(axes))])
        for name in ("response", "deviation")
    )
    rest, gauge = (
        np.array([[at_rest(column[i]) for column in seen] for i in range(len(axes))]) for seen in (stages, gauges)
    )
    return Coupling(axes, hertz, share, deviation, rest[..., 0], rest[..., 1], gauge[..., 0], gauge[..., 1])


def at_rest(measured: Measured) -> tuple[float, float]:
    """Real part at rest, and its standard deviation: of the lines up to ``AT_REST_HZ``, each as much as it is sure."""
    low = measured.frequency_Hz <= AT_REST_HZ
    if not low.any():
        raise CheckFailed(f"nothing was measured below {AT_REST_HZ:g} Hz: the coupling at rest is not known")
    values, deviation = measured.response.real[low], np.maximum(measured.deviation[low], _LEAST)
    weight = deviation**-2.0
    mean = float(np.sum(weight * values) / np.sum(weight))
    scatter = float(np.sqrt(np.sum(weight * (values - mean) ** 2) / np.sum(weight) / max(len(values) - 1, 1)))
    return mean, max(float(np.sum(weight) ** -0.5), scatter)


# The motion y_j of the others comes in as a disturbance of the stage, ``C_ij y_j``, of which the outer loop leaves its
# sensitivity ``S_i``. Decoupling (``rt/laws/coordinate_transform.py``) moves the stage by
# ``-c_ij G_i (1 + lead s) / g_i`` of it ahead, so that
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


_UNSURE = 2.0
"""Standard deviations of the coupling by which the bound is widened."""


@dataclass(frozen=True)
class Together:
    """`interaction`: the Perron root, at worst, with the coupling's uncertainty, at `interaction_Hz`.

    `turns` counts encirclements, over positive and negative frequencies (Nyquist): 0 is stable.
    """

    interaction: float
    interaction_Hz: float
    turns: int

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
    )
