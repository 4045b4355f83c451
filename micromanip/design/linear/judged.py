"""From recordings to a judged linear model: what ``fit linear`` does, for scripts and notebooks too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed

from .experiments import LinearRecord, same_rate
from .fit import fit_linear
from .frequency import FrequencyResponse, frequency_response
from .modal import Array
from .model import LinearFit

_SHOWN_VALUES = 40


@dataclass(frozen=True)
class Judged:
    """A model, what it was fitted to, its free run on what was held out, and the response measured directly."""

    model: LinearFit
    held_out: list[LinearRecord]
    fit_percent: Array
    rms_error_percent: Array
    validation: tuple[Array, Array] | None
    measured: FrequencyResponse

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
            "validation": self.validation
            and {"fit_percent": self.validation[0].tolist(), "rms_error_percent": self.validation[1].tolist()},
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
        }


def fit_records(
    records: Sequence[LinearRecord],
    validation: LinearRecord | None,
    order: int | None,
    split: float,
    progress: Callable[[str], None] = lambda _: None,
) -> Judged:
    """Fit to the first `split` of each record, judge by the free run on the rest, and on `validation`.

    Where nothing is left (`split` 1), the validation record, which must be given then, stands for the rest. Errors of
    several held-out parts are averaged. CheckFailed for data that can't be used.
    """
    same_rate([*records, *([validation] if validation else [])])
    parts = [record.split(split) for record in records]
    judged = [rest for _, rest in parts if rest is not None]
    if not judged and validation is not None:
        judged = [validation]
    try:
        model = fit_linear([(part.u, part.y) for part, _ in parts], records[0].dt, order, progress=progress)
        progress("frequency response")
        measured = frequency_response([(record.u, record.y) for record in records], model.dt)
    except ValueError as problem:
        raise CheckFailed(f"{records[0].file}: {problem}") from problem
    progress("free run")
    rms = np.sqrt(np.mean([model.errors(part.u, part.y)[1] ** 2 for part in judged], axis=0))
    other = model.errors(validation.u, validation.y) if validation else None
    return Judged(model, judged, 100.0 - rms, rms, other, measured)
