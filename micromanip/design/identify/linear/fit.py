"""``fit_linear``: a linear model of given or chosen order from recordings, refined by its free run.

Order, delays and direct term by what they are worth: the free run on the part of the record that was left out.

Where little moves in that part, as behind a single blow, models are much alike there. Then they are judged by
the free run on all of the record.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from micromanip.control.system import Array

from .modal import Experiment, Modes, decompose, dynamics, observability
from .model import LinearFit, as_columns, delayed
from .regression import NormalEquations, Start, block, first_answers, join, mixing, real_columns, regress, solve, start

LARGEST_ORDER = 12
_ENOUGH = 1.02
"""The smallest order whose held-out error is within this factor of the best one is chosen."""
_WORTH = 1.1
"""A delay is shortened, which is as good as a state more, only where the held-out error falls by this factor."""
_EXACT = 1e-6
"""Held-out errors below this share of the output are all alike: rounding."""
_STRIDE = 4
_HELD_OUT = 4
_MOVES, _MOVES_WELL = 0.02, 0.2
"""Mean square of the outputs, as a share of that elsewhere, below which a part says nothing, or little, of a model."""
_ENOUGH_FITTED = 1.1
"""The same factor where errors are those of what is fitted to, which fall with each state."""


def says_much(part: Sequence[Experiment], whole: Sequence[Experiment], least: float = _MOVES) -> bool:
    """Whether the outputs of `part` move enough, beside those of `whole`, for models to differ there."""
    power, usual = (
        np.sum([((y - y.mean(axis=0)) ** 2).sum(axis=0) for _, y in each], axis=0) / sum(len(y) for _, y in each)
        for each in (part, whole)
    )
    return bool(np.mean(power / np.maximum(usual, 1e-300)) > least)


def last_quarter_says_much(experiments: Sequence[Experiment]) -> bool:
    """Whether models can be judged by the last quarter of each experiment."""
    quarters = [(u[-(len(u) // _HELD_OUT) :], y[-(len(u) // _HELD_OUT) :]) for u, y in experiments]
    return says_much(quarters, experiments, _MOVES_WELL)


@dataclass(frozen=True)
class Structure:
    """What is not estimated by least squares; `tried` has the held-out rms error (percent) of each order."""

    order: int
    delays: tuple[int, ...]
    direct: bool
    tried: dict[int, float]

    @property
    def error(self) -> float:
        """Held-out rms error, percent of the outputs'."""
        return self.tried[self.order]


def modes_of(left: Array, order: int, experiments: Sequence[Experiment], direct: bool) -> Modes:
    """Modes of the first `order` columns of the observability matrix, B and D fitted."""
    A, C = dynamics(left, order, experiments[0][1].shape[1])
    return regress(*decompose(A, C), experiments, direct=direct)


def choose(
    experiments: Sequence[Experiment],
    order: int | None,
    lags: Sequence[int],
    direct: bool | None,
    rows: int,
    progress: Callable[[str], None],
    *,
    fixed: bool = False,
) -> Structure:
    """The best structure for experiments that first answer each input after `lags` samples, or a little earlier.

    An answer that is too small to be seen in a regression can still be worth its place in the model, so each lag is
    lowered as long as the error falls well, unless they are `fixed`.
    """
    orders = range(1, min(LARGEST_ORDER, (rows - 1) * experiments[0][1].shape[1]) + 1) if order is None else (order,)

    enough = _ENOUGH if last_quarter_says_much(experiments) else _ENOUGH_FITTED

    def attempt(candidate: Sequence[int]) -> Structure:
        late = tuple(max(lag - 1, 0) for lag in candidate)
        through = min(candidate) == 0 if direct is None else direct
        progress(f"trying delays {', '.join(map(str, late))}")
        tried = _errors(experiments, late, orders, through, rows)
        limit = max(enough * min(tried.values()), 100.0 * _EXACT)
        return Structure(next(n for n, error in tried.items() if error <= limit), late, through, tried)

    now = list(lags)
    best = attempt(now)
    for i in range(len(now)):
        while now[i] > 0 and not fixed:
            earlier = attempt([*now[:i], now[i] - 1, *now[i + 1 :]])
            if _WORTH * max(earlier.error, 100.0 * _EXACT) > best.error:
                break
            best, now[i] = earlier, now[i] - 1
    return best if order is not None else _larger(best, experiments, rows, progress)


def _larger(
    best: Structure, experiments: Sequence[Experiment], rows: int, progress: Callable[[str], None]
) -> Structure:
    """`best`, or where it has about all the states that were tried one of more, as several outputs may need."""
    outputs = experiments[0][1].shape[1]
    tried = dict(best.tried)
    for order in range(LARGEST_ORDER + _STRIDE, min(LARGEST_ORDER * outputs, (rows - 1) * outputs) + 1, _STRIDE):
        if best.order < order - 2 * _STRIDE:
            break
        progress(f"trying order {order}")
        tried |= _errors(experiments, best.delays, [order], best.direct, rows)
        if _ENOUGH * tried[order] < best.error:
            best = Structure(order, best.delays, best.direct, tried)
    return Structure(best.order, best.delays, best.direct, tried)


def _errors(
    experiments: Sequence[Experiment], delays: tuple[int, ...], orders: Iterable[int], direct: bool, rows: int
) -> dict[int, float]:
    """Held-out rms error (percent) of each order; the state runs on from the fitted part, the offset is refitted.

    That on all of the record, which is fitted to, where the last quarter says nothing.
    """
    shifted = [delayed(pair, delays) for pair in experiments]
    judged = last_quarter_says_much(experiments)
    counts = [len(u) - len(u) // _HELD_OUT if judged else len(u) for u, _ in shifted]
    fitted = [(u[:count], y[:count]) for (u, y), count in zip(shifted, counts, strict=True)]
    left, _ = observability(fitted, rows)
    errors = {}
    for order in orders:
        modes = modes_of(left, order, fitted, direct)
        left_over = size = 0.0
        for (u, y), count in zip(shifted, counts, strict=True):
            error = (y - start(modes, u[:count], y[:count]).run(modes, u))[count if judged else 0 :]
            left_over += float(np.sum((error - error.mean(axis=0)) ** 2))
            # of the whole record: the output may stand still where it is held out
            size += float(np.sum(y.var(axis=0))) * len(error)
        errors[order] = 100.0 * float(np.sqrt(left_over / size))
    return errors


_DAMPING, _DAMPING_LIMIT = 1e-3, 1e6
_GAIN = 1e-4
"""A step that takes less than this share off the cost is the last."""


def _signals(modes: Modes, u: Array, begin: Start) -> tuple[Array, Array]:
    """Free run (n, l) and the signals that its derivatives are made of."""
    responses, free = modes.responses(u), modes.free(len(u))
    state = np.einsum("nkm,km->nk", responses, modes.B) + free * begin.x0
    # dx+/dp = p dx/dp + x: the state filtered once more
    parts = [modes.through(state), responses.reshape(len(u), -1), state, free]
    y = ((state * modes.weights) @ modes.C.T).real + u @ modes.D.T + begin.offset
    return y, np.hstack([*(real_columns(part) for part in parts), u, np.ones((len(u), 1))])


def _mixes(modes: Modes, *, direct: bool) -> tuple[list[Array], int]:
    """For each output the weights of `_signals` in its derivatives; parameters in the order of `_moved`."""
    k, m, outputs, n, w = len(modes.poles), modes.B.shape[1], len(modes.C), modes.order, modes.weights
    at_b, at_c, at_d = n, n + n * m, n + n * m + n * outputs
    common = at_d + (outputs * m if direct else 0)
    rows = 2 * k * (m + 3) + m + 1
    mixes = []
    for o in range(outputs):
        coefficients = modes.C[o]
        parts = [
            (0, 0, mixing(coefficients, w, 1)),
            (2 * k, at_b, mixing(coefficients, w, m)),
            (2 * k * (m + 1), at_c + n * o, mixing(np.ones(k, complex), w, 1)),
            (2 * k * (m + 2), common, mixing(coefficients, w, 1)),
            (rows - 1, common + n + o, np.ones((1, 1))),
        ]
        if direct:
            parts.append((2 * k * (m + 3), at_d + m * o, np.eye(m)))
        mixes.append(block(rows, *parts, columns=common + n + outputs))
    return mixes, common


def _moved(modes: Modes, step: Array, *, direct: bool) -> Modes:
    k, m, outputs, n, w = len(modes.poles), modes.B.shape[1], len(modes.C), modes.order, modes.weights
    at_c, at_d = n + n * m, n + n * m + n * outputs
    poles = modes.poles + join(step[:n], w, (k,))
    B = modes.B + join(step[n:at_c], w, (k, m))
    C = modes.C + np.stack([join(step[at_c + n * o : at_c + n * (o + 1)], w, (k,)) for o in range(outputs)])
    D = modes.D + step[at_d : at_d + outputs * m].reshape(outputs, m) if direct else modes.D
    return Modes(poles, B, C, D)


def _error(modes: Modes, experiments: Sequence[Experiment]) -> tuple[float, list[Start]]:
    starts = [start(modes, u, y) for u, y in experiments]
    runs = (begin.run(modes, u) - y for (u, y), begin in zip(experiments, starts, strict=True))
    return sum(float(np.sum(error**2)) for error in runs), starts


def refine(modes: Modes, experiments: Sequence[Experiment], steps: int, *, direct: bool) -> Modes:
    """`modes` after at most `steps` damped Gauss-Newton steps on the free-run error; never worse than before."""
    cost, starts = _error(modes, experiments)
    damping = _DAMPING
    for _ in range(steps):
        mixes, common = _mixes(modes, direct=direct)
        equations = NormalEquations(common, modes.order + len(modes.C), len(experiments))
        for e, ((u, y), begin) in enumerate(zip(experiments, starts, strict=True)):
            predicted, signals = _signals(modes, u, begin)
            equations.add(e, signals, mixes, y - predicted)
        before = cost
        while damping < _DAMPING_LIMIT:
            step = solve(equations.A + damping * np.diag(np.diag(equations.A)), equations.b)
            trial = _moved(modes, step, direct=direct)
            if np.abs(trial.poles).max() < 1.0:
                new, states = _error(trial, experiments)
                if new < cost:
                    modes, cost, starts = trial, new, states
                    damping /= 5.0
                    break
            damping *= 5.0
        if cost > before * (1.0 - _GAIN):
            break
    return modes


_REFINEMENTS = 8
_CHANNEL_ROWS, _SAMPLES_A_ROW = 120, 10
_SHORT_DELAY, _LONGEST_DELAY = 20, 200
_GRID = 2.0**24


def fit_linear(
    experiments: Sequence[Experiment],
    dt: float,
    order: int | None = None,
    *,
    delays: Sequence[int] | None = None,
    direct: bool | None = None,
    refinements: int = _REFINEMENTS,
    progress: Callable[[str], None] = lambda _: None,
) -> LinearFit:
    """Linear model from experiments ``[(u (n, inputs), y (n, outputs)), ..]`` sampled every `dt` seconds.

    Every experiment has an initial state and an offset of its own. Without an `order` the smallest is taken whose
    free run on the last quarter of each experiment is within 2 % of the best up to order 12. `delays` (samples, one
    an input) are estimated where they are not given, and so is whether there is a `direct` term, that is, whether
    an output answers within the same sample. Raises ValueError for signals that stand still or are not finite, and
    for records too short for the order.
    """
    pairs = [(as_columns(u), as_columns(y)) for u, y in experiments]
    _check(pairs, dt, delays)
    every_u, every_y = (np.concatenate([pair[side] for pair in pairs]) for side in (0, 1))
    offsets_u, offsets_y, scale_u, scale_y = every_u.mean(axis=0), every_y.mean(axis=0), every_u.std(0), every_y.std(0)
    for name, scale in (("input", scale_u), ("output", scale_y)):
        bad = np.flatnonzero(~(np.isfinite(scale) & (scale > 0)))
        if len(bad):
            raise ValueError(f"{name} {bad[0] + 1} is constant or not finite")
    # on a grid far finer than any sensor's digit: rounding must not depend on where a sensor has its zero
    scaled = [(_gridded((u - offsets_u) / scale_u), _gridded((y - offsets_y) / scale_y)) for u, y in pairs]
    shortest, channels = min(len(u) for u, _ in scaled), len(scale_u) + len(scale_y)
    least = -(-3 * (order or 1) // (2 * len(scale_y))) + 1
    rows = max(least, min(_CHANNEL_ROWS, shortest // _SAMPLES_A_ROW) // channels)
    if shortest < 4 * rows * channels or rows < 3:
        needed = 4 * max(rows, 3) * channels
        raise ValueError(f"an experiment of {shortest} samples is too short; at least {needed} are needed")
    if order is not None and not 1 <= order <= (rows - 1) * len(scale_y):
        raise ValueError(f"order {order} is not in 1 .. {(rows - 1) * len(scale_y)}, what {rows} block rows can show")
    tried: dict[int, float] = {}
    if delays is None or order is None or direct is None:
        progress("delays")
        lags = [delay + 1 for delay in delays or ()]
        if delays is None:
            lags = _first_answers(scaled, shortest // (4 * channels))
        found = choose(scaled, order, lags, direct, rows, progress, fixed=delays is not None)
        order, delays, direct, tried = found.order, found.delays, found.direct, found.tried
    late = tuple(int(delay) for delay in delays)
    shifted = [delayed(pair, late) for pair in scaled]
    progress(f"subspace, order {order}")
    left, values = observability(shifted, rows)
    modes = modes_of(left, order, shifted, direct)
    seen = np.linalg.eigvals(dynamics(left, order, len(scale_y))[0])
    progress("refining")
    modes = refine(modes, shifted, refinements, direct=direct)
    physical = Modes(modes.poles, modes.B / scale_u, modes.C * scale_y[:, None], modes.D * scale_y[:, None] / scale_u)
    return LinearFit(
        physical,
        dt,
        late,
        offsets_u,
        offsets_y,
        values,
        tried,
        tuple(complex(pole) for pole in seen[(np.abs(seen) > 1.0) & (seen.imag >= 0.0)]),
    )


def _gridded(scaled: Array) -> Array:
    return np.asarray(np.rint(scaled * _GRID) / _GRID)


def _first_answers(experiments: Sequence[Experiment], most: int) -> list[int]:
    """The lag at which each input first shows; looked for among few first, then among up to `most` or `_LONGEST_DELAY`.

    An input that shows at none of them may act slowly from the first on.
    """
    found = first_answers(experiments, min(_SHORT_DELAY, most))
    if None in found and most > _SHORT_DELAY:
        later = first_answers(experiments, min(_LONGEST_DELAY, most))
        found = [late if lag is None else lag for lag, late in zip(found, later, strict=True)]
    return [lag or 0 for lag in found]


def _check(pairs: Sequence[Experiment], dt: float, delays: Sequence[int] | None) -> None:
    if not dt > 0:
        raise ValueError(f"the sampling interval must be positive, not {dt}")
    if not pairs:
        raise ValueError("there is no experiment")
    inputs, outputs = pairs[0][0].shape[1], pairs[0][1].shape[1]
    for number, (u, y) in enumerate(pairs, 1):
        if len(u) != len(y) or u.shape[1] != inputs or y.shape[1] != outputs:
            raise ValueError(f"experiment {number} has arrays of {u.shape} and {y.shape}: (n, inputs), (n, outputs)")
    if delays is not None and (len(delays) != inputs or min(delays) < 0):
        raise ValueError(f"delays must be {inputs} numbers of samples from 0, not {list(delays)}")
