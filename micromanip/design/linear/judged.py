"""From recordings to a judged linear model: what ``fit linear`` does, for scripts and notebooks too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed

from .experiments import LinearRecord, same_rate
from .fit import fit_linear
from .frequency import FrequencyResponse, frequency_response
from .modal import Array
from .model import LinearFit, strict_errors
from .predictor import fit_unstable, foretold_errors, horizon
from .selection import select
from .subspace import Experiment

_SHOWN_VALUES = 40
_POOR_PERCENT, _GOOD_PERCENT, _COHERENT = 70.0, 20.0, 0.8
"""Rms errors of a model that predicts little, and of one that predicts; coherence of columns that are of one plant."""


@dataclass(frozen=True)
class Judged:
    """A model, its free run on what was held out, that of ARX(1), and the response measured directly.

    The strict errors (outputs,) are those behind the first tenth of each part, to which state and offset are fitted.
    Of an unstable model there is no free run: errors are of what it foretells `ahead` samples, and no strict ones.
    """

    model: LinearFit
    held_out: list[LinearRecord]
    fit_percent: Array
    rms_error_percent: Array
    strict_percent: Array
    arx1_percent: Array
    validation: dict[str, list[float]] | None
    measured: FrequencyResponse
    notes: list[str]
    ahead: int | None = None

    def report(self) -> dict[str, Any]:
        """The machine-readable result."""
        model = self.model
        poles = model.poles[np.lexsort((model.poles.imag, -np.abs(model.poles)))]
        s = np.log(np.where(poles == 0, 1e-300, poles).astype(complex)) / model.dt
        matrices = model.state_space()
        return {
            "order": model.order,
            "foretold_samples": self.ahead,
            "delay_samples": list(model.delays),
            "fit_percent": self.fit_percent.tolist(),
            "rms_error_percent": self.rms_error_percent.tolist(),
            "strict_fit_percent": (100.0 - self.strict_percent).tolist(),
            "arx1_strict_fit_percent": (100.0 - self.arx1_percent).tolist(),
            "validation": self.validation,
            "poles_z": [[pole.real, pole.imag] for pole in poles.tolist()],
            "poles_Hz": [float(abs(value)) / (2.0 * np.pi) for value in s],
            "poles_damping": [float(-value.real / abs(value)) for value in s],
            "singular_values": model.singular_values[:_SHOWN_VALUES].tolist(),
            "tried": {str(order): error for order, error in model.tried.items()},
            "coherence": self.measured.explained.tolist(),
            "dt_s": model.dt,
            "A": matrices.A.tolist(),
            "B": matrices.B.tolist(),
            "C": matrices.C.tolist(),
            "D": matrices.D.tolist(),
            "K": model.kalman_gain.tolist(),
            "offsets_u": model.offsets_u.tolist(),
            "offsets_y": model.offsets_y.tolist(),
            "notes": self.notes,
        }


def fit_records(
    records: Sequence[LinearRecord],
    validation: LinearRecord | None,
    order: int | None,
    split: float,
    progress: Callable[[str], None] = lambda _: None,
    *,
    unstable: bool = False,
) -> Judged:
    """Fit to the first `split` of each record (MOESP, Verhaegen 1994), judge by the free run on the rest.

    So on `validation`, which stands for the rest where nothing is left (`split` 1) and must be given then. Errors of
    several held-out parts are averaged. An `unstable` plant has no free run: it is judged as far ahead as it grows
    e-fold. CheckFailed for data that can't be used.
    """
    same_rate([*records, *([validation] if validation else [])])
    parts = [record.split(split) for record in records]
    judged = [rest for _, rest in parts if rest is not None]
    if not judged and validation is not None:
        judged = [validation]
    fitted_to, left_out = _experiments(part for part, _ in parts), _experiments(judged)
    if unstable:
        return _judged_ahead(records, validation, order, (fitted_to, left_out), judged, progress)
    try:
        selected = select(fitted_to, left_out, records[0].dt, order, progress)
        model = selected.model
        progress("frequency response")
        measured = frequency_response(_experiments(records), model.dt)
    except ValueError as problem:
        raise CheckFailed(f"{records[0].file}: {problem}") from problem
    progress("free run")
    rms = _rms(model, left_out)
    if rms.min() > _POOR_PERCENT and measured.explained.min() > _COHERENT:
        progress("the other way round")
        _require_driven(records[0], rms, fitted_to, left_out, model.dt)
    strict, arx1 = strict_errors(model, left_out), strict_errors(selected.arx1, left_out)
    other = None
    if validation is not None:
        unseen = validation.experiments
        errors = _rms(model, unseen)
        other = {
            "fit_percent": (100.0 - errors).tolist(),
            "rms_error_percent": errors.tolist(),
            "strict_fit_percent": (100.0 - strict_errors(model, unseen)).tolist(),
        }
    return Judged(model, judged, 100.0 - rms, rms, strict, arx1, other, measured, selected.notes)


def _judged_ahead(
    records: Sequence[LinearRecord],
    validation: LinearRecord | None,
    order: int | None,
    parts: tuple[list[Experiment], list[Experiment]],
    judged: list[LinearRecord],
    progress: Callable[[str], None],
) -> Judged:
    try:
        model = fit_unstable(parts[0], records[0].dt, order, progress)
        measured = frequency_response(_experiments(records), model.dt)
        samples = min(len(u) for u, _ in parts[1])
        ahead = horizon(model, samples)
        rms = foretold_errors(model, parts[1], ahead)
        unseen = None if validation is None else foretold_errors(model, validation.experiments, ahead)
    except ValueError as problem:
        raise CheckFailed(f"{records[0].file}: {problem}") from problem
    grows = samples * np.log(np.abs(model.poles).max()) > 1.0
    notes = [] if grows else ["no pole grows within the record: without --unstable a free run judges the model"]
    none = np.full(len(rms), np.nan)
    other = None
    if unseen is not None:
        other = {"fit_percent": (100.0 - unseen).tolist(), "rms_error_percent": unseen.tolist()}
        other["strict_fit_percent"] = none.tolist()
    return Judged(model, judged, 100.0 - rms, rms, none, none, other, measured, notes, ahead)


def _require_driven(
    record: LinearRecord, rms: Array, fitted_to: Sequence[Experiment], left_out: Sequence[Experiment], dt: float
) -> None:
    """Raise CheckFailed where a model from the outputs to the inputs predicts: the inputs are what answers."""
    try:
        inverse = fit_linear([(y, u) for u, y in fitted_to], dt)
    except ValueError:
        return
    found = _rms(inverse, [(y, u) for u, y in left_out])
    if found.max() < _GOOD_PERCENT:
        driven, seen = ", ".join(record.inputs), ", ".join(record.outputs)
        raise CheckFailed(
            f"{record.file}: {seen} runs ahead of {driven}: from {driven} to {seen} a model fits with "
            f"{max(0.0, 100.0 - rms.max()):.0f} %, the other way round with {100.0 - found.max():.0f} %: the columns "
            "are probably mixed up (--input is what drives, --output what answers), or a loop is closed around them"
        )


def _experiments(records: Iterable[LinearRecord]) -> list[Experiment]:
    return [pair for record in records for pair in record.experiments]


def _rms(model: LinearFit, experiments: Sequence[Experiment]) -> Array:
    """Rms error of the free run (outputs,), percent, averaged over the experiments."""
    return np.asarray(np.sqrt(np.mean([model.errors(u, y)[1] ** 2 for u, y in experiments], axis=0)))
