"""Fitting: multi-start least squares on cost (14), uncertainties, and the choice among structures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from micromanip.settings.schema.hysteresis import PrandtlIshlinskii, Range

from .shapings import Affine, Table, Tanh
from .structure import Structure

Array = NDArray[np.float64]

_COARSE_SAMPLES = 6000
_BLOCKS = 20
_KNOTS = 6
_CREEP_S = (0.1, 1.0, 10.0, 100.0)


@dataclass(frozen=True)
class HysteresisFit:
    """A fitted model; errors in um on the record after its burn-in."""

    structure: Structure
    x: Array
    model: PrandtlIshlinskii
    rms_um: float
    max_um: float
    rms_std_um: float
    cost: float
    parameter_std: Array
    stroke_um: float

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
        return self.structure.value(self.x, np.asarray(voltage_V, dtype=float))[0]

    def held_out(self, voltage_V: Array, displacement_um: Array, burn_in: int) -> tuple[float, float]:
        """Rms and maximum, percent of stroke, on a record it was not fitted to; the offset is refitted."""
        error = (self.predict(voltage_V) - displacement_um)[burn_in:]
        error = error - error.mean()
        stroke = float(np.ptp(displacement_um[burn_in:]))
        return 100.0 * float(np.sqrt(np.mean(error**2))) / stroke, 100.0 * float(np.abs(error).max()) / stroke


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


def _solve(
    structure: Structure, start: Array, v: Array, y: Array, burn_in: int, evaluations: int
) -> tuple[Array, float]:
    prior = structure.prior(float(np.ptp(y)) * np.sqrt(len(y)))

    last: list[Array] = []

    def at(x: Array) -> list[Array]:
        """`x` with displacement and Jacobian there, computed once for both callers."""
        if not last or not np.array_equal(last[0], x):
            last[:] = [x.copy(), *structure.value(x, v)]
        return last

    def residual(x: Array) -> Array:
        return np.concatenate([(at(x)[1] - y)[burn_in:], prior @ x])

    def jacobian(x: Array) -> Array:
        return np.vstack([at(x)[2][burn_in:], prior])

    # MINPACK: no singular values of a tall matrix, which BLAS threads would make slower instead of faster
    with np.errstate(over="ignore", invalid="ignore"):
        solution = least_squares(residual, start, jac=jacobian, x_scale="jac", max_nfev=evaluations, method="lm")
    return solution.x, float(solution.cost)


def fit(
    structure: Structure,
    voltage_V: Array,
    displacement_um: Array,
    range_um: Range,
    burn_in: int = 0,
    starts: int = 8,
    seed: int = 0,
    progress: Callable[[], None] = lambda: None,
) -> HysteresisFit:
    """Fit `structure` to a record (n,), (n,); the first `burn_in` samples do not count.

    Starts are tried on a thinned record, the best one is polished on all samples.
    """
    v, y = np.ascontiguousarray(voltage_V, dtype=float), np.ascontiguousarray(displacement_um, dtype=float)
    thin = max(1, len(v) // _COARSE_SAMPLES)
    coarse = replace(structure, step_s=structure.step_s * thin)
    rng = np.random.default_rng(seed)
    tried = []
    for k in range(starts):
        start = structure.start(y, rng, 0.0 if k == 0 else 1.0)
        try:
            tried.append(_solve(coarse, start, v[::thin].copy(), y[::thin].copy(), burn_in // thin, 80))
        except (ValueError, np.linalg.LinAlgError):
            continue  # a start may leave the range of floating point; the others go on
        finally:
            progress()
    if not tried:
        raise ValueError("no start of the fit converged; the record may not show a hysteresis loop")
    best = min(tried, key=lambda candidate: candidate[1])[0]
    x, cost = _solve(structure, best, v, y, burn_in, 60)
    return _judged(structure, x, cost, v, y, burn_in, range_um)


def _judged(
    structure: Structure, x: Array, cost: float, v: Array, y: Array, burn_in: int, range_um: Range
) -> HysteresisFit:
    predicted, jacobian = structure.value(x, v)
    error, jacobian = (predicted - y)[burn_in:], jacobian[burn_in:]
    blocks = np.array([np.mean(block**2) for block in np.array_split(error, _BLOCKS)])
    rms = float(np.sqrt(np.mean(error**2)))
    rms_std = float(blocks.std() / np.sqrt(_BLOCKS) / (2 * rms)) if rms > 0 else 0.0
    # neighbouring residuals are alike: only every so many of them counts as a measurement of its own
    centred = error - error.mean()
    spectrum = np.abs(np.fft.rfft(centred, 2 * len(centred))) ** 2
    correlation = np.fft.irfft(spectrum)[: len(centred)]
    alike = 1.0 + 2.0 * float(np.abs(correlation[1 : len(centred) // 10]).sum() / max(correlation[0], 1e-300))
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * rms**2 * alike
    return HysteresisFit(
        structure,
        x,
        structure.settings(x, range_um),
        rms,
        float(np.abs(error).max()),
        rms_std,
        cost,
        np.sqrt(np.maximum(np.diag(covariance), 0.0)),
        float(np.ptp(y[burn_in:])),
    )
