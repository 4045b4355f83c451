"""Offset v0 and gain N of the inverse over amplitude (figure 7), over amplitude and offset as a map; its verdict.

Actuator model (6) and its inverse (7) as one operator: shaping, plays, shaping, over a steady sine.

Both are ``output = after(gain u + sum_i weight_i G_i[u])`` with ``u = before(input)``: the model shapes before the
plays, its inverse after them. The shaping functions are those of the loop itself. What depends on speed or time
(rate dependence, creep) is left out: a describing function is that of the rate-independent part.

Describing function by quadrature, equations (18)-(21): any shaping, any offset, model and inverse.

The integrands are analytic between the angles at which a play begins to move or a table has a corner; the period
is split there and each piece integrated by Gauss-Legendre, so that the error is that of rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import root

from micromanip.control.system import Array, Complex
from micromanip.rt.jit import Compiler
from micromanip.rt.laws.feedforward import HYSTERESIS_PARAMETERS
from micromanip.rt.laws.hysteresis import shape, unshape
from micromanip.settings.compile.hysteresis import fill_prandtl_ishlinskii
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii, Range, attainable_um, phi_range


@dataclass(frozen=True)
class LimitCycle:
    """Oscillation that would keep itself up: amplitude at the nonlinear element, frequency, residual of L N = -1."""

    amplitude: float
    frequency_Hz: float
    residual: float


def limit_cycles(
    gain: Callable[[float], complex], amplitudes: Array, response: Callable[[Array], Complex], omega: Array
) -> list[LimitCycle]:
    """All intersections of ``-1/N(A)`` with ``L(i omega)``, both followed along their grids, then refined.

    `gain` gives N at one amplitude, `amplitudes` (k,) is the grid; `response` gives L at `omega` (n,), rad/s.
    An amplitude where N is not finite interrupts the locus.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        locus = np.asarray(-1.0 / np.array([gain(float(a)) for a in amplitudes]), dtype=complex)
    curve = response(omega)
    found: list[LimitCycle] = []
    for i, j in _crossings(locus, curve):
        start = np.log([0.5 * (amplitudes[i] + amplitudes[i + 1]), 0.5 * (omega[j] + omega[j + 1])])
        bounds = np.log([[amplitudes[i], omega[j]], [amplitudes[i + 1], omega[j + 1]]])
        solved = root(_mismatch, start, args=(gain, response))
        # the solver may run off; then the crossing of the two pieces themselves is the answer
        inside = ((solved.x >= bounds[0] - 0.1) & (solved.x <= bounds[1] + 0.1)).all()
        x = solved.x if solved.success and inside else start
        cycle = LimitCycle(
            float(np.exp(x[0])),
            float(np.exp(x[1]) / (2 * np.pi)),
            float(np.hypot(*_mismatch(x, gain, response))),
        )
        if not any(np.allclose([c.amplitude, c.frequency_Hz], [cycle.amplitude, cycle.frequency_Hz]) for c in found):
            found.append(cycle)
    return found


def _mismatch(x: Array, gain: Callable[[float], complex], response: Callable[[Array], Complex]) -> Array:
    amplitude, omega = np.exp(x)
    product = complex(response(np.array([omega]))[0]) * gain(float(amplitude)) + 1.0
    return np.array([product.real, product.imag])


def _crossings(p: Complex, q: Complex) -> list[tuple[int, int]]:
    """Pairs of segments of the polylines `p` and `q` that cross."""
    a, b = p[:-1, None], p[1:, None]
    c, d = q[None, :-1], q[None, 1:]

    def side(origin: Complex, end: Complex, point: Complex) -> Array:
        return np.asarray(np.sign((np.conj(end - origin) * (point - origin)).imag))

    with np.errstate(invalid="ignore"):
        apart = side(a, b, c) * side(a, b, d)
        across = side(c, d, a) * side(c, d, b)
        hit = (apart < 0) & (across <= 0)
    return [(int(i), int(j)) for i, j in np.argwhere(hit)]


compiled = Compiler(__file__, allocates=True)


@compiled
def _shape_all(p: Any, x: Any, y: Any) -> None:
    for k in range(len(x)):
        y[k] = shape(p, x[k])


@compiled
def _unshape_all(p: Any, x: Any, y: Any) -> None:
    for k in range(len(x)):
        y[k] = unshape(p, x[k])


@dataclass(frozen=True)
class Operator:
    """Plays between two monotone maps; thresholds and weights (n,), `u_limits` the values the plays' sum may take."""

    gain: float
    thresholds: Array
    weights: Array
    shaping: Any
    inverse: bool
    u_limits: tuple[float, float]

    def before(self, x: Array) -> Array:
        """The plays' input for the operator's input `x`, elementwise."""
        return x if self.inverse else self._mapped(_shape_all, x)

    def before_inverse(self, u: Array) -> Array:
        """The operator's input at which the plays see `u`."""
        return u if self.inverse else self._mapped(_unshape_all, u)

    def after(self, total: Array) -> Array:
        """The operator's output for the sum `total` of the plays."""
        return self._mapped(_unshape_all, total) if self.inverse else total

    @property
    def knots(self) -> Array:
        """Corners of a table shaping: values of the operator's input (model) or of the plays' sum (inverse)."""
        points = int(self.shaping["points"])
        return np.array(self.shaping["u" if self.inverse else "v"][:points])

    def total(self, u: Array, w: Array) -> Array:
        """``gain u + sum weight_i w_i`` for inputs `u` (k,) and play outputs `w` (k, n)."""
        return self.gain * u + w @ self.weights

    def _mapped(self, mapping: Any, x: Array) -> Array:
        flat = np.ascontiguousarray(x, dtype=float).ravel()
        y = np.empty_like(flat)
        mapping(self.shaping, flat, y)
        return y.reshape(np.shape(x))

    def swing(self, centre: float, amplitude: float) -> tuple[float, float, Array, Array]:
        """Ends of u and the plays' outputs (n,) there, in the steady state of a sine begun at rest by (3)."""
        u0, u_low, u_high = self.before(np.array([centre, centre - amplitude, centre + amplitude]))
        w = np.zeros(len(self.thresholds))
        for u in (u0, u_high, u_low):
            w = _moved(u, self.thresholds, w)
        return float(u_low), float(u_high), w, _moved(u_high, self.thresholds, w)


def _moved(u: float, r: Array, w: Array) -> Array:
    return np.maximum(u - r, np.minimum(u + r, w))


def inverse_operator(model: PrandtlIshlinskii) -> Operator:
    """The feedforward (7): displacement (um) to voltage (V)."""
    p = _filled(model)
    n = int(p["plays"])
    return Operator(
        1.0 / model.alpha, p["r_hat"][:n].copy(), p["rho_hat"][:n].copy(), p["shaping"], True, phi_range(model)
    )


def actuator_operator(model: PrandtlIshlinskii) -> Operator:
    """The model of the actuator (6): voltage (V) to displacement (um)."""
    p = _filled(model)
    n = int(p["plays"])
    return Operator(model.alpha, p["r"][:n].copy(), p["rho"][:n].copy(), p["shaping"], False, (-np.inf, np.inf))


def _filled(model: PrandtlIshlinskii) -> Any:
    record = np.zeros(1, HYSTERESIS_PARAMETERS)
    # the period matters for creep and rate dependence only, which are left out
    fill_prandtl_ishlinskii(record[0], model, 1e-4)
    return record[0]


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


@dataclass(frozen=True)
class Harmonics:
    """Mean ``v0`` (18) and gain ``N = (a1 + i b1)/A`` (21) of the response to ``x0 + A sin``.

    ``headroom`` is the distance of the plays' sum to the end of phi's range, as a share of half that range: 1 in its
    middle, 0 at the end, where a tanh shaping can't be inverted any more (v0 and N are nan there); 1 without limits.
    """

    v0: float
    gain: complex
    headroom: float


def harmonics(operator: Operator, amplitude: float, centre: float = 0.0) -> Harmonics:
    """Harmonics of `operator` for the input ``centre + amplitude sin``, in the steady state after a start by (3)."""
    if not (np.isfinite(amplitude) and amplitude > 0 and np.isfinite(centre)):
        raise ValueError(f"the amplitude must be positive and finite, the offset finite, not {amplitude}, {centre}")
    u_low, u_high, w_low, w_high = operator.swing(centre, amplitude)
    ends = operator.total(np.array([u_low, u_high]), np.array([w_low, w_high]))
    headroom = _headroom(ends, operator.u_limits)
    if headroom <= 0.0:
        return Harmonics(np.nan, complex(np.nan, np.nan), headroom)
    mean = a1 = b1 = 0.0
    for rising, w0, start in ((True, w_low, u_low), (False, w_high, u_high)):
        edges = _edges(operator, amplitude, centre, rising, start, w0)
        half = 0.5 * np.diff(edges)[:, None]
        angle = (edges[:-1, None] + half * (1.0 + _NODES)).ravel()
        weight = (half * _WEIGHTS).ravel()
        y = operator.after(_branch(operator, operator.before(centre + amplitude * np.sin(angle)), rising, w0))
        mean += float(weight @ y)
        a1 += float(weight @ (y * np.sin(angle)))
        b1 += float(weight @ (y * np.cos(angle)))
    return Harmonics(mean / (2.0 * np.pi), complex(a1, b1) / (np.pi * amplitude), headroom)


def _branch(operator: Operator, u: Array, rising: bool, w0: Array) -> Array:
    """Sum of the plays at `u` (k,) on the branch that leaves the plays' outputs `w0` (n,)."""
    r = operator.thresholds
    moved = np.maximum(u[:, None] - r, w0) if rising else np.minimum(u[:, None] + r, w0)
    return operator.total(u, moved)


def _edges(operator: Operator, amplitude: float, centre: float, rising: bool, start: float, w0: Array) -> Array:
    """Angles at which a piece of the branch begins or ends, rising: -pi/2..pi/2 and falling: pi/2..3pi/2."""
    turns = w0 + operator.thresholds if rising else w0 - operator.thresholds
    inputs = operator.before_inverse(turns)
    if operator.inverse and len(operator.knots):
        # on a branch the plays' sum is a polyline in u that rises or falls steadily: invert it between its corners
        end = centre + amplitude if rising else centre - amplitude
        corners = np.sort(np.concatenate([[start, end], turns[(turns - start) * (turns - end) < 0]]))
        heights = _branch(operator, corners, rising, w0)
        inside = operator.knots[(operator.knots > heights[0]) & (operator.knots < heights[-1])]
        inputs = np.concatenate([inputs, np.interp(inside, heights, corners)])
    else:
        inputs = np.concatenate([inputs, operator.knots])
    sine = (inputs - centre) / amplitude
    angles = np.arcsin(sine[np.abs(sine) < 1.0])
    ends = np.array([-0.5, 0.5]) * np.pi
    edges = np.unique(np.concatenate([ends, angles]))
    return edges if rising else np.pi - edges[::-1]


def _headroom(ends: Array, limits: tuple[float, float]) -> float:
    low, high = limits
    if not np.isfinite(low):
        return 1.0
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    return float(1.0 - np.abs(ends - middle).max() / half)


@dataclass(frozen=True)
class Sweep:
    """Over amplitudes (k,) in um about ``offset_um``: ``v0_V`` (k,), ``gain_V_per_um`` (k,), headroom (k,)."""

    offset_um: float
    amplitude_um: Array
    v0_V: Array
    gain_V_per_um: Complex
    headroom: Array


@dataclass(frozen=True)
class GainMap:
    """``gain_V_per_um`` (offsets, amplitudes); nan where the sine leaves the set-point's range or has no inverse."""

    offset_um: Array
    amplitude_um: Array
    gain_V_per_um: Complex
    headroom: Array


def sweep(model: PrandtlIshlinskii, offset_um: float, amplitude_um: Array) -> Sweep:
    """Describing function of the inverse of `model` over amplitudes (k,) about one offset."""
    operator = inverse_operator(model)
    return _row(operator, offset_um, np.asarray(amplitude_um, dtype=float))


def _row(operator: Operator, offset_um: float, amplitude_um: Array) -> Sweep:
    found = [harmonics(operator, float(a), offset_um) for a in amplitude_um]
    return Sweep(
        offset_um,
        amplitude_um,
        np.array([h.v0 for h in found]),
        np.array([h.gain for h in found]),
        np.array([h.headroom for h in found]),
    )


def amplitudes_up_to(largest_um: float, thresholds: Array, count: int) -> Array:
    """About `count` even amplitudes up to `largest_um`, and those at and beside every threshold below it."""
    even = np.linspace(largest_um / count, largest_um, count)
    near = np.concatenate([thresholds * factor for factor in (1.0 - 1e-3, 1.0, 1.0 + 1e-3)])
    return np.unique(np.concatenate([even, near[(near > 0) & (near < largest_um)]]))


def gain_map(model: PrandtlIshlinskii, range_um: Range, offsets: int = 41, amplitudes: int = 40) -> GainMap:
    """Map over the offsets and amplitudes whose sines stay inside `range_um`."""
    low, high = range_um
    operator = inverse_operator(model)
    half = 0.5 * (high - low)
    offset = np.linspace(low, high, offsets)
    amplitude = np.linspace(half / amplitudes, half, amplitudes)
    gain = np.full((offsets, amplitudes), complex(np.nan, np.nan))
    headroom = np.full((offsets, amplitudes), np.nan)
    for i, centre in enumerate(offset):
        inside = amplitude <= min(centre - low, high - centre) + 1e-9 * half
        if inside.any():
            row = _row(operator, float(centre), amplitude[inside])
            gain[i, inside], headroom[i, inside] = row.gain_V_per_um, row.headroom
    return GainMap(offset, amplitude, gain, headroom)


def branch_slopes(model: PrandtlIshlinskii, range_um: Range, points: int = 401) -> tuple[float, float]:
    """The flattest and the steepest slope (um/V) of the model on its way through `range_um`, up and down.

    A describing function averages over a swing: while a set-point moves one way, a small signal on it meets the branch.
    """
    operator, way = inverse_operator(model), np.linspace(*range_um, points)
    there_and_back = np.concatenate([way, way[-2:0:-1]])
    w, total = np.zeros(len(operator.thresholds)), np.zeros(2 * len(there_and_back) + 1)
    path_um = np.concatenate([there_and_back, there_and_back, way[:1]])
    for k, u in enumerate(path_um):
        w = np.maximum(u - operator.thresholds, np.minimum(u + operator.thresholds, w))
        total[k] = operator.gain * u + w @ operator.weights
    settled = slice(len(there_and_back), None)  # the first round begins at rest
    slopes = np.diff(path_um[settled]) / np.diff(operator.after(total[settled]))
    slopes = slopes[np.isfinite(slopes) & (slopes > 0.0)]  # beyond its range an inverse has none
    return float(slopes.min(initial=np.inf)), float(slopes.max(initial=0.0))


STEEP = 5.0
"""A gain this many times the median of the map counts as blowing up."""
JUMP = 1e-3
"""A relative change of N that does not vanish between ever nearer amplitudes counts as a jump."""
_BISECTIONS = 40


@dataclass(frozen=True)
class Verdict:
    """``problems`` in words, none where the inverse is regular over the whole range; and the figures behind them."""

    attainable_um: Range
    gain_range_V_per_um: Range
    jump: float
    problems: tuple[str, ...]


def judge(model: PrandtlIshlinskii, range_um: Range, gain: GainMap) -> Verdict:
    """Verdict over the set-points `range_um`; `gain` is the map over that range."""
    problems = []
    reach = attainable_um(model)
    if reach[0] > range_um[0] or reach[1] < range_um[1]:
        problems.append(
            f"set-points {range_um[0]:g}..{range_um[1]:g} um go beyond what the shaping can reach, "
            f"{reach[0]:.4g}..{reach[1]:.4g} um"
        )
    size = np.abs(gain.gain_V_per_um)
    tried = np.isfinite(gain.headroom)
    blank = tried & ~np.isfinite(size)
    if blank.any():
        i, j = np.argwhere(blank)[0]
        problems.append(
            f"no inverse for a sine of {gain.amplitude_um[j]:.3g} um about {gain.offset_um[i]:.3g} um: "
            f"the {model.shaping} shaping ends there"
        )
    finite = size[np.isfinite(size)]
    if not len(finite):
        return Verdict(reach, (np.nan, np.nan), np.nan, tuple(problems))
    if finite.max() > STEEP * np.median(finite):
        i, j = np.unravel_index(np.nanargmax(size), size.shape)
        problems.append(
            f"|N| blows up: {finite.max():.3g} V/um at {gain.amplitude_um[j]:.3g} um about {gain.offset_um[i]:.3g} um, "
            f"{finite.max() / np.median(finite):.1f} times its median"
        )
    jump = largest_jump(inverse_operator(model), gain)
    if jump > JUMP:
        problems.append(f"N jumps by {100.0 * jump:.2g} % between neighbouring amplitudes")
    return Verdict(
        reach,
        (float(finite.min()), float(finite.max())),
        jump,
        tuple(problems),
    )


def largest_jump(operator: Operator, gain: GainMap) -> float:
    """Relative change of N that is left where it changes most, once the amplitudes have been bisected together."""
    change = np.abs(np.diff(gain.gain_V_per_um, axis=1))
    if not np.isfinite(change).any():
        return 0.0
    i, j = np.unravel_index(np.nanargmax(change), change.shape)
    centre = float(gain.offset_um[i])
    low, high = float(gain.amplitude_um[j]), float(gain.amplitude_um[j + 1])
    at_low, at_high = (harmonics(operator, a, centre).gain for a in (low, high))
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        between = harmonics(operator, middle, centre).gain
        if abs(between - at_low) > abs(at_high - between):
            high, at_high = middle, between
        else:
            low, at_low = middle, between
    return abs(at_high - at_low) / abs(at_low)
