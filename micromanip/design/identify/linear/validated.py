"""From recordings to a judged linear model: what ``fit linear`` does, for scripts and notebooks too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import csd

from micromanip.control.system import Array, Complex
from micromanip.errors import CheckFailed
from micromanip.recordings import TimeSeries

from ...data import same_rate
from .experiments import split_at
from .fit import fit_linear
from .modal import Experiment
from .model import LinearFit, strict_errors
from .selection import select

_SHOWN_VALUES = 40
_AVERAGES, _LONGEST = 8, 1 << 14
"""Segments wanted for each input: with as many as there are inputs the coherence would be 1 whatever the data; samples
in a segment, at most."""
_POOR_PERCENT, _GOOD_PERCENT, _COHERENT = 70.0, 20.0, 0.8
"""Rms errors of a model that predicts little, and of one that predicts; coherence of columns that are of one plant."""


@dataclass(frozen=True)
class ValidatedFit:
    """A model, its free run on what was held out, that of ARX(1), and the coherence (outputs,) of inputs and outputs.

    The strict errors (outputs,) are those behind the first tenth of each part, to which state and offset are fitted.
    """

    model: LinearFit
    held_out: list[TimeSeries]
    fit_percent: Array
    rms_error_percent: Array
    strict_percent: Array
    arx1_percent: Array
    validation: dict[str, list[float]] | None
    coherence: Array
    notes: list[str]

    def report(self) -> dict[str, Any]:
        """The machine-readable result."""
        model = self.model
        poles = model.poles[np.lexsort((model.poles.imag, -np.abs(model.poles)))]
        s = np.log(np.where(poles == 0, 1e-300, poles).astype(complex)) / model.dt
        matrices = model.state_space()
        return {
            "order": model.order,
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
            "coherence": self.coherence.tolist(),
            "dt_s": model.dt,
            "A": matrices.A.tolist(),
            "B": matrices.B.tolist(),
            "C": matrices.C.tolist(),
            "D": matrices.D.tolist(),
            "offsets_u": model.offsets_u.tolist(),
            "offsets_y": model.offsets_y.tolist(),
            "notes": self.notes,
        }


def fit_records(
    records: Sequence[TimeSeries],
    validation: TimeSeries | None,
    order: int | None,
    split: float,
    progress: Callable[[str], None] = lambda _: None,
) -> ValidatedFit:
    """Fit to the first `split` of each record (MOESP, Verhaegen 1994), judge by the free run on the rest.

    So on `validation`, which stands for the rest where nothing is left (`split` 1) and must be given then. Errors of
    several held-out parts are averaged. CheckFailed for data that can't be used.
    """
    same_rate([*records, *([validation] if validation else [])])
    parts = [split_at(record, split) for record in records]
    judged = [rest for _, *left in parts for rest in left]
    if not judged and validation is not None:
        judged = [validation]
    fitted_to, left_out = _experiments(part for part, *_ in parts), _experiments(judged)
    try:
        selected = select(fitted_to, left_out, records[0].step_s, order, progress)
        model = selected.model
        progress("coherence")
        coherence = coherence_of(_experiments(records))
    except ValueError as problem:
        raise CheckFailed(f"{records[0].file}: {problem}") from problem
    progress("free run")
    rms = _rms(model, left_out)
    if rms.min() > _POOR_PERCENT and coherence.min() > _COHERENT:
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
    return ValidatedFit(model, judged, 100.0 - rms, rms, strict, arx1, other, coherence, selected.notes)


def _require_driven(
    record: TimeSeries, rms: Array, fitted_to: Sequence[Experiment], left_out: Sequence[Experiment], dt: float
) -> None:
    """Raise CheckFailed where a model from the outputs to the inputs predicts: the inputs are what answers."""
    try:
        inverse = fit_linear([(y, u) for u, y in fitted_to], dt)
    except ValueError:
        return
    found = _rms(inverse, [(y, u) for u, y in left_out])
    if found.max() < _GOOD_PERCENT:
        driven, seen = ", ".join(record.names[: record.inputs]), ", ".join(record.names[record.inputs :])
        raise CheckFailed(
            f"{record.file}: {seen} runs ahead of {driven}: from {driven} to {seen} a model fits with "
            f"{max(0.0, 100.0 - rms.max()):.0f} %, the other way round with {100.0 - found.max():.0f} %: the columns "
            "are probably mixed up (--input is what drives, --output what answers), or a loop is closed around them"
        )


def _experiments(records: Iterable[TimeSeries]) -> list[Experiment]:
    return [pair for record in records for pair in record.experiments]


def _rms(model: LinearFit, experiments: Sequence[Experiment]) -> Array:
    """Rms error of the free run (outputs,), percent, averaged over the experiments."""
    return np.asarray(np.sqrt(np.mean([model.errors(u, y)[1] ** 2 for u, y in experiments], axis=0)))


def coherence_of(experiments: Sequence[Experiment]) -> Array:
    """Multiple coherence over all frequencies (outputs,): the share of an output's power that the inputs explain.

    ``S_yu S_uu^-1 S_uy / S_yy`` of spectra averaged over all experiments ``(u (n, inputs), y (n, outputs))`` by Welch's
    method; 1 without noise and nonlinearity. Bendat and Piersol, Random Data, chapters 6 and 7. Raises ValueError where
    not even two segments an input fit in.
    """
    inputs, segment = experiments[0][0].shape[1], _LONGEST
    while segment > 16 and _segments(experiments, segment) < _AVERAGES * inputs:
        segment //= 2
    count = _segments(experiments, segment)
    if count < 2 * inputs:
        raise ValueError(f"{count} segments of {segment} samples are too few for {inputs} inputs: record longer")
    long = [np.hstack(pair) for pair in experiments if len(pair[0]) >= segment]
    S = np.sum([_segments([(x, x)], segment) * _cross_spectra(x, segment) for x in long], axis=0)
    s_uu, s_uy = S[:, :inputs, :inputs], S[:, :inputs, inputs:]
    power = np.trace(s_uu, axis1=1, axis2=2).real / inputs
    regular = s_uu + 1e-14 * max(float(power.max()), 1e-300) * np.eye(inputs)
    explained = np.einsum("fay,fay->y", s_uy.conj(), np.linalg.solve(regular, s_uy)).real
    whole = np.einsum("fyy->y", S[:, inputs:, inputs:]).real
    return np.asarray(np.clip(explained / whole, 0.0, 1.0))


def _segments(experiments: Sequence[Experiment], segment: int) -> int:
    return sum(max(0, (len(u) - segment) // (segment // 2) + 1) for u, _ in experiments)


def _cross_spectra(signals: Array, segment: int) -> Complex:
    """Mean of ``conj(X_a) X_b`` (f, channels, channels) over segments of signals (n, channels) without their means."""
    centred = signals - signals.mean(axis=0)
    pairs = csd(
        centred[:, :, None], centred[:, None, :], nperseg=segment, detrend=False, return_onesided=False, axis=0
    )[1]
    return np.asarray(pairs)[1 : segment // 2 + 1]
