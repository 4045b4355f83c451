"""A linear model that predicts: orders, refinement and ARX(1) beside one another on parts that none was fitted to."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from micromanip.control.system import Complex

from .fit import fit_linear, last_quarter_says_much, says_much
from .modal import Experiment, Modes
from .model import LinearFit, delayed, strict_errors

_REFINED = 8
"""Steps of refinement that are tried beside none."""
_NO_WORSE = 1.0 + 1e-9
_STABLE = 1.0 - 1e-6
_SLOWEST, _LINES, _ALL = 4, 8, 0.999
"""Periods of a sine, lines of the spectrum that it and another have through a window, and their share of the power."""
_GROWS, _LAGS = 5.0, 10
"""Logarithm of how much an unstable response grows over a record: less may be noise; of an autoregression that has it,
too."""


@dataclass(frozen=True)
class Selected:
    """A model, what ARX(1) makes of the same data, and what is to be told about the choice."""

    model: LinearFit
    arx1: LinearFit
    notes: list[str]


def error_of(model: LinearFit, experiments: Sequence[Experiment]) -> float:
    """Strict error, rms over the outputs, percent."""
    return float(np.sqrt(np.mean(strict_errors(model, experiments) ** 2)))


def select(
    experiments: Sequence[Experiment],
    held_out: Sequence[Experiment],
    dt: float,
    order: int | None,
    progress: Callable[[str], None] = lambda _: None,
) -> Selected:
    """Fit to `experiments`, with an `order` or the best.

    The part held out is looked at only to see that the model is not worse than ARX(1) there; a model that is, is
    replaced where no order was asked for, and told of. Raises ValueError as `fit_linear` does.
    """
    model = fit_linear(experiments, dt, order, progress=progress)
    arx1 = fit_arx1(experiments, dt, model.delays)
    notes = []
    if order is None and not last_quarter_says_much(experiments):
        notes.append(
            f"order {model.order} is chosen by the error on all that is fitted to, as little moves in its "
            "last quarter: a record with more movement tells more, --order sets another"
        )
    notes += [*_of_one_frequency(experiments, dt), *_of_mirrored(model, experiments)]
    progress("comparing with ARX(1)")
    limit, found = error_of(arx1, held_out), error_of(model, held_out)
    if not says_much(held_out, experiments):
        notes.append(
            "in the part held out hardly anything moves, so its figures say little: split elsewhere, or give --split 1 "
            "and another record with --validate"
        )
        return Selected(model, arx1, notes)
    if not np.isfinite(limit) or found <= limit * _NO_WORSE:
        return Selected(model, arx1, notes)
    if order is not None:
        notes.append(
            f"order {order} predicts worse than ARX(1): strict error {found:.5g} %, ARX(1) {limit:.5g} %; "
            "another --order, or a longer record"
        )
        return Selected(model, arx1, notes)
    tried, direct = [(limit, arx1, "ARX(1)")], bool(np.any(model.modes.D))
    for states, steps in itertools.product((model.order, 1, 2), (_REFINED, 0)):
        try:
            other = fit_linear(experiments, dt, states, delays=model.delays, direct=direct, refinements=steps)
        except (ValueError, np.linalg.LinAlgError):
            continue
        tried.append((error_of(other, held_out), other, f"order {states}{'' if steps else ', not refined'}"))
    error, best, name = min(tried, key=lambda entry: entry[0])
    notes.append(
        f"{name} instead of order {model.order}, which predicts worse than ARX(1) (strict error {found:.5g} %, "
        f"ARX(1) {limit:.5g} %, {name} {error:.5g} %): chosen on the part held out, which flatters its figures; "
        "record more"
    )
    return Selected(replace(best, tried=model.tried), arx1, notes)


def _of_one_frequency(experiments: Sequence[Experiment], dt: float) -> list[str]:
    """What is to be told of inputs that are a sine, or two: most models agree with such a record."""
    notes = []
    longest = max((u for u, _ in experiments), key=len)
    for k, u in enumerate(longest.T, 1):
        power = np.abs(np.fft.rfft((u - u.mean()) * np.hanning(len(u)))) ** 2
        peak = int(np.argmax(power))
        if peak >= _SLOWEST and np.sort(power)[-_LINES:].sum() > _ALL * power.sum():
            near = np.arange(peak - 2, min(peak + 3, len(power)))
            hertz = float(near @ power[near] / power[near].sum()) / (len(u) * dt)
            notes.append(f"input {k} moves at {hertz:.3g} Hz only: what the model says of other frequencies is a guess")
    return notes


def _of_mirrored(model: LinearFit, experiments: Sequence[Experiment]) -> list[str]:
    """What is to be told of poles outside the unit circle: of those that grow well, and that a regression has, too."""
    samples = max(len(u) for u, _ in experiments)
    grows = [pole for pole in model.mirrored if samples * np.log(abs(pole)) > _GROWS]
    others = _regressed_poles(experiments) if grows else np.zeros(0)
    grows = [pole for pole in grows if np.abs(others - pole).min(initial=np.inf) < 0.5 * (abs(pole) - 1.0)]
    if not grows:
        return []
    worst = max(grows, key=abs)
    inside = 1.0 / worst.conjugate()
    return [
        f"the record has an unstable pole, z = {_pole(worst)}, which grows e-fold in "
        f"{model.dt / np.log(abs(worst)):.3g} s: it was mirrored to {_pole(inside)}, so the model is not the plant's. "
        "An unstable plant can only have been recorded in a closed loop: fit from the loop's set-point, or an "
        "injected signal, to the output"
    ]


def _regressed_poles(experiments: Sequence[Experiment]) -> Complex:
    """Poles of ``y[k] = sum A_i y[k-i] + sum B_i u[k-i] + c``, which a closed loop leaves as they are."""
    tables, targets, outputs = [], [], experiments[0][1].shape[1]
    for u, y in experiments:
        past = np.hstack([each[_LAGS - lag : len(y) - lag] for each in (y, u) for lag in range(1, _LAGS + 1)])
        tables.append(past - past.mean(axis=0))
        targets.append(y[_LAGS:] - y[_LAGS:].mean(axis=0))
    weights = np.linalg.lstsq(np.vstack(tables), np.vstack(targets), rcond=None)[0]
    past_of_y = outputs * _LAGS
    return np.linalg.eigvals(np.vstack([weights[:past_of_y].T, np.eye(past_of_y)[:-outputs]])).astype(complex)


def _pole(z: complex) -> str:
    return f"{z.real:.4f}" if abs(z.imag) < 1e-6 else f"{z.real:.4f} +-{abs(z.imag):.4f}j"


def fit_arx1(experiments: Sequence[Experiment], dt: float, delays: tuple[int, ...]) -> LinearFit:
    """ARX(1), the least that is called a model: ``y[k] = a y[k-1] + b u[k-1-delay] + c``, least squares by output.

    Of experiments ``(u (n, inputs), y (n, outputs))``, each with an offset of its own. What is chosen with more care
    must not predict worse.
    """
    offsets_u = np.concatenate([u for u, _ in experiments]).mean(axis=0)
    offsets_y = np.concatenate([y for _, y in experiments]).mean(axis=0)
    shifted = [delayed((u - offsets_u, y - offsets_y), delays) for u, y in experiments]
    outputs = len(offsets_y)
    poles, driven = np.empty(outputs, complex), np.empty((outputs, len(offsets_u)))
    for o in range(outputs):
        rows = [np.column_stack([y[:-1, o], u[:-1]]) for u, y in shifted]
        table = np.concatenate([row - row.mean(axis=0) for row in rows])
        target = np.concatenate([y[1:, o] - y[1:, o].mean() for _, y in shifted])
        found = np.linalg.lstsq(table, target, rcond=None)[0]
        pole = float(np.clip(found[0], -_STABLE, _STABLE))
        poles[o], driven[o] = pole, found[1:]
    # a mode's real form has a real pole; two alike are kept apart by a rounding
    poles = poles - 1e-9 * np.arange(outputs)
    modes = Modes(poles, driven.astype(complex), np.eye(outputs).astype(complex), np.zeros((outputs, len(offsets_u))))
    return LinearFit(modes, dt, delays, offsets_u, offsets_y, np.zeros(0), {})
