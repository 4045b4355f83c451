"""From a judged recording to a judged model: what ``fit hysteresis`` does, for scripts and notebooks too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from micromanip.design.hysteresis import fit
from micromanip.errors import CheckFailed
from micromanip.settings.schema.hysteresis import Network, PrandtlIshlinskii

from .hysteresis import Candidate, HysteresisFit, candidates, choose, structure_of
from .network import NetworkFit, smoothed
from .network_fit import fit_network
from .record import Record

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Request:
    """What is to be fitted."""

    kind: str
    creep: bool = False
    plays: int = 10
    seed: int = 0
    burn_in_s: float = 0.0


@dataclass(frozen=True)
class Fitted:
    """A model with its figures; errors in percent of the stroke."""

    kind: str
    settings: PrandtlIshlinskii | Network
    predict: Callable[[Array], Array]
    burn_in: int
    rms_percent: float
    max_percent: float
    validation: dict[str, float] | None
    rms_std_percent: float | None = None
    tried: list[Candidate] = field(default_factory=list)

    def report(self) -> dict[str, Any]:
        """The machine-readable result."""
        return {
            "model": self.kind,
            "rms_percent": self.rms_percent,
            "rms_std_percent": self.rms_std_percent,
            "max_percent": self.max_percent,
            "validation": self.validation,
            "parameters": self.settings.model_dump(mode="json", exclude_defaults=True),
            "candidates": [
                {
                    "model": candidate.structure.name,
                    "smoothness": candidate.structure.smoothness,
                    "rms_percent": candidate.fitted_percent,
                    "held_out_percent": candidate.held_out_percent,
                }
                for candidate in self.tried
            ],
        }


def fit_record(
    record: Record, held_out: Record | None, request: Request, progress: Callable[[str], None] = lambda _: None
) -> Fitted:
    """Fit what `request` asks for; `held_out` is only ever predicted. CheckFailed where nothing can be fitted."""
    burn_in = record.burn_in(request.burn_in_s)
    if held_out is not None:
        _same_rate(record.step_s, held_out)
        held_out.burn_in(request.burn_in_s)
    used = record.y[burn_in:]
    range_um = (float(used.min()), float(used.max()))
    if request.kind == "network":
        return _fit_network(record, held_out, request, burn_in, range_um, progress)
    try:
        if request.kind == "best":
            structures = candidates(record.u, record.step_s, request.plays)
            best, tried = choose(structures, record.u, record.y, range_um, burn_in, progress)
        else:
            structure = structure_of(request.kind, record.u, record.step_s, request.plays, request.creep)
            best, tried = fit(structure, record.u, record.y, range_um, burn_in, seed=request.seed), []
    except ValidationError as problem:
        what = problem.errors()[0]["msg"].removeprefix("Value error, ")
        raise CheckFailed(f"{record.file}: the fitted {request.kind} model has no inverse: {what}") from problem
    except ValueError as problem:
        raise CheckFailed(f"{record.file}: {problem}") from problem
    return Fitted(
        best.structure.name,
        best.model,
        best.predict,
        burn_in,
        best.rms_percent,
        best.max_percent,
        _validation(best, held_out, request),
        100.0 * best.rms_std_um / best.stroke_um,
        tried,
    )


def _validation(best: HysteresisFit, held_out: Record | None, request: Request) -> dict[str, float] | None:
    if held_out is None:
        return None
    rms, maximum = best.held_out(held_out.u, held_out.y, held_out.burn_in(request.burn_in_s))
    return {"rms_percent": rms, "max_percent": maximum}


def _same_rate(step_s: float, held_out: Record) -> None:
    if abs(held_out.step_s / step_s - 1.0) > 0.01:
        raise CheckFailed(
            f"{held_out.file}: sampled every {held_out.step_s:.6g} s, the fitted record every {step_s:.6g} s; "
            "record both at one rate"
        )


def _fit_network(
    record: Record,
    held_out: Record | None,
    request: Request,
    burn_in: int,
    range_um: tuple[float, float],
    progress: Callable[[str], None],
) -> Fitted:
    """Forward network, which is judged, and the inverse one (section 3.4), which the loop gets."""

    def train(name: str, u: Array, y: Array) -> NetworkFit:
        def say(what: str) -> None:
            progress(f"{name} network, {what}")

        return fit_network(u, y, seed=request.seed, burn_in=burn_in, progress=say)

    progress("smoothing the measured displacement")
    forward, inverse = train("forward", record.u, record.y), train("inverse", smoothed(record.y), record.u)
    error = (forward.predict(record.u) - record.y)[burn_in:]
    stroke = float(np.ptp(record.y[burn_in:]))
    validation = None
    if held_out is not None:
        _same_rate(record.step_s, held_out)
        first = held_out.burn_in(request.burn_in_s)
        other = (forward.predict(held_out.u) - held_out.y)[first:]
        validation = _percent(other - other.mean(), float(np.ptp(held_out.y[first:])))
    own = _percent(error, stroke)
    model = inverse.to_settings(range_um)
    return Fitted("network", model, forward.predict, burn_in, own["rms_percent"], own["max_percent"], validation)


def _percent(error: Array, stroke: float) -> dict[str, float]:
    rms, largest = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    return {"rms_percent": 100.0 * rms / stroke, "max_percent": 100.0 * largest / stroke}
