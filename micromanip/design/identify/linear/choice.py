"""Order, delays and direct term by what they are worth: the free run on the part of the record that was left out.

Where little moves in that part, as behind a single blow, models are much alike there. Then they are judged by
the free run on all of the record.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from .modal import Array, Modes, decompose
from .model import delayed
from .regression import regress, start
from .subspace import Experiment, dynamics, observability

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
