"""Fitting: multi-start least squares on cost (14), uncertainties, and the choice among structures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from micromanip.control.system import Array
from micromanip.recordings.spikes import find_spikes, off_median
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii, Range

from .structure import Affine, Structure, Table, Tanh, about_zero, span

Flags = NDArray[np.bool_]

_BEGUN, _PLACES = 0.1, 41
"""Share of a record by which the plays' start is found, and how many are tried."""
_COARSE_SAMPLES = 6000
_BLOCKS = 20
_KNOTS = 6
_CREEP_S = (0.1, 1.0, 10.0, 100.0)


@dataclass(frozen=True)
class HysteresisFit:
    """A fitted model; errors in um on the samples of the record that count.

    `spikes` (n,) are samples that were found to be wrong by what the model leaves of them: they do not count either.
    `delay_samples` is the dead time before everything else.
    """

    structure: Structure
    x: Array
    model: PrandtlIshlinskii
    rms_um: float
    max_um: float
    rms_std_um: float
    cost: float
    stroke_um: float
    spikes: Flags
    delay_samples: float = 0.0

    @property
    def rms_percent(self) -> float:
        """Of the record's stroke after the burn-in."""
        return 100.0 * self.rms_um / self.stroke_um

    @property
    def max_percent(self) -> float:
        """Of the record's stroke after the burn-in."""
        return 100.0 * self.max_um / self.stroke_um

    def predict(self, voltage_V: Array) -> Array:
        """Displacement (n,) in um over `voltage_V` (n,), sampled like the record."""
        return self.structure.value(self.x, late(np.asarray(voltage_V, dtype=float), self.delay_samples))[0]

    def begun(self, voltage_V: Array, displacement_um: Array, counts: Flags) -> HysteresisFit:
        """The model on another record (n,), (n,): where its plays were before, by the first tenth that `counts`."""
        first = np.flatnonzero(counts)
        used = first[: max(2, round(_BEGUN * len(first)))]
        part = slice(0, int(used[-1]) + 1)
        v = late(np.asarray(voltage_V, dtype=float), self.delay_samples)
        u = self.structure.shaping.value(self.x[: self.structure.shaping.count], v)[0]
        reach = u - self.x[self.structure.shaping.offset]
        best, least = self, np.inf
        for place in np.linspace(float(reach.min()), float(reach.max()), _PLACES):
            x = np.append(self.x[:-1], place)
            error = (self.structure.value(x, v[part])[0] - displacement_um[part])[used]
            cost = float(np.var(error))
            if cost < least * (1.0 - 1e-9):
                best, least = replace(self, x=x), cost
        return best

    def held_out(self, voltage_V: Array, displacement_um: Array, counts: int | Flags) -> tuple[float, float]:
        """Rms and maximum, percent of stroke, on what it was not fitted to, of the samples that count (n,), or those
        from number `counts` on; the offset is refitted.
        """
        return held_out_percent(self.predict(voltage_V), displacement_um, counting(len(voltage_V), counts))


def percents(error: Array, measured: Array) -> tuple[float, float]:
    """Rms and maximum of an `error` (n,), percent of the stroke of what was `measured` (n,)."""
    stroke = float(np.ptp(measured))
    return 100.0 * float(np.sqrt(np.mean(error**2))) / stroke, 100.0 * float(np.abs(error).max()) / stroke


def held_out_percent(predicted: Array, measured: Array, used: Flags) -> tuple[float, float]:
    """The same of samples that are `used` (n,) and were not fitted to; the offset is refitted."""
    error = (predicted - measured)[used]
    return percents(error - error.mean(), measured[used])


def structure_of(
    kind: str, voltage_V: Array, step_s: float, plays: int = 10, creep: bool = False, smoothness: float = 1e-2
) -> Structure:
    """One of the kinds ``pi-affine``, ``pi-tanh``, ``pi-free``, ``rate`` over the voltages (n,), sampled at `step_s`.

    `creep` adds first-order lags, one a decade between ten samples and a quarter of the record (a longer one would
    describe how this record began, and no other); `smoothness` weighs how alike neighbouring steps of table
    and weights of ``pi-free`` are.
    """
    duration = len(voltage_V) * step_s
    creep_s = tuple(tau for tau in _CREEP_S if 10 * step_s <= tau <= duration / 4) if creep else ()
    name = kind + ("+creep" if creep else "")
    if kind == "pi-affine":
        return Structure(Affine(voltage_V), plays, False, step_s, creep_s, name=name)
    if kind == "pi-free":
        return Structure(Table(voltage_V, _KNOTS), plays, True, step_s, creep_s, smoothness=smoothness, name=name)
    if kind not in ("pi-tanh", "rate"):
        raise ValueError(f"unknown kind of model {kind!r}")
    return Structure(Tanh(voltage_V), plays, False, step_s, creep_s, rate=kind == "rate", name=name)


def counting(samples: int, counts: int | Flags) -> Flags:
    """Which of `samples` count, (n,): all from number `counts` on, or as it says itself."""
    return np.arange(samples) >= counts if isinstance(counts, int) else counts


def late(v: Array, samples: float) -> Array:
    """`v` (n,) that many samples later, which need not be whole; before it stands still."""
    at = np.arange(len(v))
    return np.interp(at - samples, at, v) if samples else v


def _solve(
    structure: Structure, start: Array, v: Array, y: Array, used: Flags, evaluations: int
) -> tuple[Array, float]:
    prior = structure.prior(float(np.ptp(y)) * np.sqrt(len(y)))

    last: list[Array] = []

    def at(x: Array) -> list[Array]:
        """`x` with displacement and Jacobian there, computed once for both callers."""
        if not last or not np.array_equal(last[0], x):
            last[:] = [x.copy(), *structure.value(x, v)]
        return last

    def residual(x: Array) -> Array:
        return np.concatenate([(at(x)[1] - y)[used], prior @ x])

    def jacobian(x: Array) -> Array:
        return np.vstack([at(x)[2][used], prior])

    # MINPACK: no singular values of a tall matrix, which BLAS threads would make slower instead of faster
    with np.errstate(over="ignore", invalid="ignore"):
        solution = least_squares(residual, start, jac=jacobian, x_scale="jac", max_nfev=evaluations, method="lm")
    return solution.x, float(solution.cost)


def fit(
    structure: Structure,
    voltage_V: Array,
    displacement_um: Array,
    range_um: Range,
    burn_in: int | Flags = 0,
    starts: int = 8,
    seed: int = 0,
) -> HysteresisFit:
    """Fit `structure` to a record (n,), (n,); the first `burn_in` samples do not count, or those that it (n,) excludes.

    Starts are tried on a thinned record, the best one is polished on all samples. Single samples that the model then
    leaves far from all others are excluded, and it is polished once more.
    """
    used = counting(len(voltage_V), burn_in)
    centred, v, y, middle = _centred(structure, voltage_V, displacement_um, used)
    thin = max(1, len(v) // _COARSE_SAMPLES)
    coarse = replace(centred, step_s=structure.step_s * thin)
    rng = np.random.default_rng(seed)
    tried = []
    for k in range(starts):
        start = structure.start(y, rng, 0.0 if k == 0 else 1.0)
        try:
            tried.append(_solve(coarse, start, v[::thin].copy(), y[::thin].copy(), used[::thin], 80))
        except (ValueError, np.linalg.LinAlgError):
            continue  # a start may leave the range of floating point; the others go on
    if not tried:
        raise ValueError("no start of the fit converged; the record may not show a hysteresis loop")
    best = min(tried, key=lambda candidate: candidate[1])[0]
    x, cost = _solve(centred, best, v, y, used, 200)
    left = centred.value(x, v)[0] - y  # spikes stand out of the measurement itself, not only of the model
    wrong = find_spikes(left) & (off_median(y) > 0.5 * off_median(left)) & used
    if wrong.any():
        x, cost = _solve(centred, x, v, y, used & ~wrong, 200)
    return _judged(structure, x, cost, v, y, used & ~wrong, middle, range_um, wrong)


def delayed(fitted: HysteresisFit, samples: float, v: Array, y: Array, used: Flags, range_um: Range) -> HysteresisFit:
    """`fitted` once more, from where it is, behind a dead time of so many samples."""
    kept = used & ~fitted.spikes
    centred, v, about, middle = _centred(fitted.structure, late(v, samples), y, used)
    start = fitted.structure.shifted(fitted.x, -middle)
    x, cost = _solve(centred, start, v, about, kept, 200)
    found = _judged(fitted.structure, x, cost, v, about, kept, middle, range_um, fitted.spikes)
    return replace(found, delay_samples=samples)


def _centred(structure: Structure, v: Array, y: Array, used: Flags) -> tuple[Structure, Array, Array, float]:
    """Structure and signals about zero, with the same parameters but for the offset, and the middle of `y`."""
    shaping = structure.shaping
    middle, half = span(y[used])
    return (
        replace(structure, shaping=shaping.about_zero()),
        about_zero(np.asarray(v, dtype=float), shaping.middle, shaping.half),
        about_zero(np.asarray(y, dtype=float), middle, half),
        middle,
    )


def _judged(
    structure: Structure,
    x: Array,
    cost: float,
    v: Array,
    y: Array,
    used: Flags,
    middle: float,
    range_um: Range,
    spikes: Flags,
) -> HysteresisFit:
    """The model and its errors; `x` and `y` are about zero, which is at `middle`."""
    predicted, _ = replace(structure, shaping=structure.shaping.about_zero()).value(x, v)
    error = (predicted - y)[used]
    x = structure.shifted(x, middle)
    blocks = np.array([np.mean(block**2) for block in np.array_split(error, _BLOCKS)])
    rms = float(np.sqrt(np.mean(error**2)))
    rms_std = float(blocks.std() / np.sqrt(_BLOCKS) / (2 * rms)) if rms > 0 else 0.0
    return HysteresisFit(
        structure,
        x,
        structure.settings(x, range_um),
        rms,
        float(np.abs(error).max()),
        rms_std,
        cost,
        float(np.ptp(y[used])),
        spikes,
    )
