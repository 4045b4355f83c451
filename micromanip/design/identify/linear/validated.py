"""From recordings to a judged linear model: what ``fit linear`` does, for scripts and notebooks too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import get_window

from micromanip.errors import CheckFailed
from micromanip.recordings import TimeSeries

from ...data import same_rate
from .experiments import split_at
from .fit import fit_linear
from .modal import Array, Complex, Experiment
from .model import LinearFit, strict_errors
from .predictor import fit_unstable, foretold_errors, horizon
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
    Of an unstable model there is no free run: errors are of what it foretells `ahead` samples, and no strict ones.
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
    *,
    unstable: bool = False,
) -> ValidatedFit:
    """Fit to the first `split` of each record (MOESP, Verhaegen 1994), judge by the free run on the rest.

    So on `validation`, which stands for the rest where nothing is left (`split` 1) and must be given then. Errors of
    several held-out parts are averaged. An `unstable` plant has no free run: it is judged as far ahead as it grows
    e-fold. CheckFailed for data that can't be used.
    """
    same_rate([*records, *([validation] if validation else [])])
    parts = [split_at(record, split) for record in records]
    judged = [rest for _, *left in parts for rest in left]
    if not judged and validation is not None:
        judged = [validation]
    fitted_to, left_out = _experiments(part for part, *_ in parts), _experiments(judged)
    if unstable:
        return _judged_ahead(records, validation, order, (fitted_to, left_out), judged, progress)
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


def _judged_ahead(
    records: Sequence[TimeSeries],
    validation: TimeSeries | None,
    order: int | None,
    parts: tuple[list[Experiment], list[Experiment]],
    judged: list[TimeSeries],
    progress: Callable[[str], None],
) -> ValidatedFit:
    try:
        model = fit_unstable(parts[0], records[0].step_s, order, progress)
        coherence = coherence_of(_experiments(records))
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
    return ValidatedFit(model, judged, 100.0 - rms, rms, none, none, other, coherence, notes, ahead)


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
    window = get_window("hann", segment)
    spectra = [[_spectra(signal, segment, window) for signal in pair] for pair in experiments]
    U, Y = (np.concatenate(parts) for parts in zip(*spectra, strict=True))
    s_uu, s_yu = np.einsum("sfa,sfb->fab", U, U.conj()), np.einsum("sfa,sfb->fab", Y, U.conj())
    s_yy = np.sum(np.abs(Y) ** 2, axis=0)
    power = np.trace(s_uu, axis1=1, axis2=2).real / inputs
    regular = s_uu + 1e-14 * max(float(power.max()), 1e-300) * np.eye(inputs)
    response = np.linalg.solve(regular.transpose(0, 2, 1), s_yu.transpose(0, 2, 1)).transpose(0, 2, 1)
    explained: Array = np.einsum("fab,fab->fa", response, s_yu.conj()).real.sum(axis=0) / s_yy.sum(axis=0)
    return np.clip(explained, 0.0, 1.0)


def _segments(experiments: Sequence[Experiment], segment: int) -> int:
    return sum(max(0, (len(u) - segment) // (segment // 2) + 1) for u, _ in experiments)


def _spectra(signal: Array, segment: int, window: Array) -> Complex:
    """Spectra (segments, f, channels) of a signal (n, channels) without its mean, in segments that overlap by half."""
    centred = signal - signal.mean(axis=0)
    if len(centred) < segment:
        return np.zeros((0, segment // 2, signal.shape[1]), complex)
    pieces = np.lib.stride_tricks.sliding_window_view(centred, segment, axis=0)[:: segment // 2]
    return np.asarray(np.fft.rfft(pieces * window, axis=2).transpose(0, 2, 1)[:, 1:])
