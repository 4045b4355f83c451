"""From a judged recording to a judged model: what ``fit hysteresis`` does, for scripts and notebooks too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.recordings import TimeSeries
from micromanip.settings.schema.hysteresis import Network, PrandtlIshlinskii

from ..data import counting, same_rate
from .hysteresis import Candidate, HysteresisFit, candidates, choose, fit, structure_of
from .hysteresis.choice import parted
from .hysteresis.fit import held_out_percent, percents
from .network.fit import NetworkFit, fit_network, reversals, smoothed

_TURN, _MINOR = 0.05, 0.8
"""Share of the input's stroke by which it comes back where it turns; a shorter way between turns is a minor loop's."""
_TURNS, _MINORS = 8, 2
_CREEP_S, _PARTS = 1.0, 4.0
"""Creep of that time constant should show; what is slower than so much of a record does not."""
_COVERED = 0.7
"""The least share of the set-point's range: `identify` covers three quarters."""


def little_seen(
    record: TimeSeries, used: NDArray[np.bool_], setpoint_um: tuple[float, float] | None = None
) -> list[str]:
    """What is to be told of the samples that are `used` (n,): empty where they have shown all that a model needs.

    `setpoint_um` is the range of the set-point that the model is for, where that is known.
    """
    at = np.flatnonzero(used)
    u, y = record.u[at[0] : at[-1] + 1], record.y[used]
    stroke_V, seconds = float(np.ptp(u)), len(at) * record.step_s
    turns = np.flatnonzero(reversals(u, _TURN * stroke_V))
    ways = np.abs(np.diff(u[turns]))
    missing = []
    if np.count_nonzero(ways < _MINOR * stroke_V) < _MINORS:
        missing.append("minor loops")
    if seconds < _PARTS * _CREEP_S:
        missing.append(f"creep slower than {seconds / _PARTS:.2g} s")
    told = []
    if missing or len(turns) < _TURNS:
        unseen = f", in which {' and '.join(missing)} did not show" if missing else ""
        told.append(
            f"fitted to {seconds:.3g} s with {len(turns)} turns over {np.ptp(y):.4g} um{unseen}: the figures hold "
            "for no more than that; record longer, with turns at many places, or look at --validate"
        )
    if setpoint_um is not None:
        low, high = setpoint_um
        covered = (min(high, float(y.max())) - max(low, float(y.min()))) / (high - low)
        if covered < _COVERED:
            told.append(
                f"{record.names[1]} covers {100.0 * max(covered, 0.0):.0f} % of the set-point's range, {low:g} to "
                f"{high:g} um: beyond, the model is continued; record the range that is used"
            )
    return told


Flags = NDArray[np.bool_]

_LEAST_COUNTING = 100
_STARTS = 12
_RIVALS, _RIVAL_EVALUATIONS = 3, 100
"""Starts and evaluations that a network gets to show whether it is worth more."""
_CLEARLY = 0.8
"""A network is chosen where its error is below this share of the best other model's: where the record has not been,
it has nothing to go by, and nothing in the record shows that.
"""


@dataclass(frozen=True)
class Request:
    """What is to be fitted; `setpoint_um` is the range of the set-point that it is for, where that is known."""

    kind: str
    creep: bool = False
    plays: int = 10
    seed: int = 0
    burn_in_s: float = 0.0
    setpoint_um: tuple[float, float] | None = None


@dataclass(frozen=True)
class Fitted:
    """A model with its figures; errors in percent of the stroke.

    `predict` runs on the record it was fitted to, `held_out` (n,) is what it says of the validation record.
    """

    kind: str
    settings: PrandtlIshlinskii | Network
    predict: Callable[[Array], Array]
    burn_in: int
    rms_percent: float
    max_percent: float
    validation: dict[str, float] | None
    held_out: Array | None = None
    rms_std_percent: float | None = None
    tried: list[Candidate] = field(default_factory=list)
    dead_time_s: float = 0.0
    notes: list[str] = field(default_factory=list)

    def report(self) -> dict[str, Any]:
        """The machine-readable result."""
        return {
            "model": self.kind,
            "rms_percent": self.rms_percent,
            "rms_std_percent": self.rms_std_percent,
            "max_percent": self.max_percent,
            "validation": self.validation,
            "parameters": self.settings.model_dump(mode="json", exclude_defaults=True),
            "dead_time_s": self.dead_time_s,
            "candidates": [
                {
                    "model": candidate.name,
                    "smoothness": candidate.structure.smoothness if candidate.structure else 0.0,
                    "rms_percent": candidate.fitted_percent,
                    "held_out_percent": candidate.held_out_percent,
                }
                for candidate in self.tried
            ],
            "notes": self.notes,
        }


def fit_record(
    record: TimeSeries, held_out: TimeSeries | None, request: Request, progress: Callable[[str], None] = lambda _: None
) -> Fitted:
    """Fit the hysteresis model that `request` asks for: displacement, um, by voltage, V, as in equations (1) to (16).

    `held_out` is only ever predicted. CheckFailed where nothing can be fitted.
    """
    used = counting(record, request.burn_in_s)
    if held_out is not None:
        same_rate([record, held_out])
        counting(held_out, request.burn_in_s)
    if used.sum() < 2 * _LEAST_COUNTING:
        raise CheckFailed(f"{record.file}: {used.sum()} samples that count are too few to fit to")
    found = _Task(record, held_out, request, used, progress).fitted()
    return replace(found, notes=[*little_seen(record, used, request.setpoint_um), *found.notes])


@dataclass(frozen=True)
class _Task:
    """What is fitted to, and how; `used` (n,) are the samples that count."""

    record: TimeSeries
    held_out: TimeSeries | None
    request: Request
    used: Flags
    progress: Callable[[str], None]

    @property
    def range_um(self) -> tuple[float, float]:
        return float(self.record.y[self.used].min()), float(self.record.y[self.used].max())

    @property
    def burn_in(self) -> int:
        return int(np.argmax(self.used))

    def fitted(self) -> Fitted:
        record, request, used = self.record, self.request, self.used
        if request.kind == "network":
            return self.network()
        try:
            if request.kind == "best":
                structures = candidates(record.u, record.step_s, request.plays)
                best, tried = choose(structures, record.u, record.y, self.range_um, used, self.progress)
                network = self.rival()
                tried = sorted([*tried, network], key=lambda candidate: candidate.merit)
                if network.merit < _CLEARLY * min(candidate.merit for candidate in tried if candidate is not network):
                    return replace(self.network(), tried=tried)
            else:
                structure = structure_of(request.kind, record.u, record.step_s, request.plays, request.creep)
                best, tried = fit(structure, record.u, record.y, self.range_um, used, _STARTS, request.seed), []
        except ValidationError as problem:
            what = problem.errors()[0]["msg"].removeprefix("Value error, ")
            raise CheckFailed(f"{record.file}: the fitted {request.kind} model has no inverse: {what}") from problem
        except ValueError as problem:
            raise CheckFailed(f"{record.file}: {problem}") from problem
        return self.judged(best, tried)

    def judged(self, best: HysteresisFit, tried: list[Candidate]) -> Fitted:
        record, begun = self.record, best
        if self.held_out is not None:
            begun = best.begun(self.held_out.u, self.held_out.y, counting(self.held_out, self.request.burn_in_s))
        notes = []
        if best.spikes.any():
            first = float(np.flatnonzero(best.spikes)[0]) * record.step_s
            notes.append(
                f"{record.names[1]}: {int(best.spikes.sum())} samples stand out of model and measurement, the first "
                f"{first:.6g} s after the start: not fitted to"
            )
        dead_time_s = best.delay_samples * record.step_s
        if dead_time_s:
            notes.append(
                f"a dead time of {1e3 * dead_time_s:.4g} ms lies before the model: the feedforward can't undo it, "
                "but its parameters are free of it"
            )
        return Fitted(
            best.structure.name + ("+delay" if dead_time_s else ""),
            best.model,
            best.predict,
            self.burn_in,
            best.rms_percent,
            best.max_percent,
            *self.validated(begun.predict),
            100.0 * best.rms_std_um / best.stroke_um,
            tried,
            dead_time_s,
            notes,
        )

    def validated(self, predict: Callable[[Array], Array]) -> tuple[dict[str, float] | None, Array | None]:
        """Errors on the validation record, whose offset is fitted, and what is predicted of it (n,), or None."""
        if self.held_out is None:
            return None, None
        counts, predicted = counting(self.held_out, self.request.burn_in_s), predict(self.held_out.u)
        rms, largest = held_out_percent(predicted, self.held_out.y, counts)
        return {"rms_percent": rms, "max_percent": largest}, predicted

    def rival(self) -> Candidate:
        """A network fitted to the first 70 % and judged on the rest, as the other kinds are."""
        record, used = self.record, self.used
        count, rest = parted(used)
        fitted = fit_network(
            record.u[:count], record.y[:count], starts=_RIVALS, seed=self.request.seed, burn_in=self.burn_in,
            evaluations=_RIVAL_EVALUATIONS, progress=lambda what: self.progress(f"network, {what}"),
        )  # fmt: skip
        predicted, fitted_to = fitted.predict(record.u), used & ~rest
        own, _ = percents((predicted - record.y)[fitted_to], record.y[fitted_to])
        return Candidate("network", own, held_out_percent(predicted, record.y, rest)[0])

    def network(self) -> Fitted:
        """Forward network, which is judged, and the inverse one (section 3.4), which the loop gets."""
        record, used = self.record, self.used

        def train(name: str, u: Array, y: Array) -> NetworkFit:
            told = lambda what: self.progress(f"{name} network, {what}")  # noqa: E731
            return fit_network(u, y, seed=self.request.seed, burn_in=self.burn_in, progress=told)

        self.progress("smoothing the measured displacement")
        forward, inverse = train("forward", record.u, record.y), train("inverse", smoothed(record.y), record.u)
        own = percents((forward.predict(record.u) - record.y)[used], record.y[used])
        model = inverse.to_settings(self.range_um)
        return Fitted("network", model, forward.predict, self.burn_in, *own, *self.validated(forward.predict))
