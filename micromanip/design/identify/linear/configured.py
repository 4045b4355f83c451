"""A fitted linear model as a configuration holds it: the stage by its set-point, one step per cycle."""

from __future__ import annotations

import numpy as np
from pydantic import ValidationError

from micromanip.errors import CheckFailed
from micromanip.recordings import TimeSeries
from micromanip.settings.check import prepared
from micromanip.settings.schema.axis import LinearModel, Outer
from micromanip.settings.text.source import Source
from micromanip.settings.wiring.timing import cycles_between, sensor_timing
from micromanip.settings.write import with_outer

from .modal import Modes
from .model import LinearFit

_WHOLE, _LESS = 0.01, "a smaller --order"
PLACE = (
    "of linear models a configuration holds the stage's position in um by the set-point in um, recorded with the "
    "strain loop closed (axes.NAME.outer.model); of um by V, `fit hysteresis --into` and `commission` make their own"
)


def require_stage(record: TimeSeries) -> None:
    """CheckFailed unless a record is of one set-point and one stage, both in stated units of length."""
    if record.inputs != 1 or len(record.names) != 2:
        raise CheckFailed(f"{record.file}: --into takes one input and one output: {PLACE}")
    for name, unit in zip(record.names, record.units, strict=True):
        if unit is None:
            raise CheckFailed(f"{record.file}: {name} states no unit, and --into takes none for granted: {name}:um")
        if unit != "um":
            raise CheckFailed(f"{record.file}: {name} is in {unit}: {PLACE}")


def per_cycle(fit: LinearFit, period_s: float) -> LinearModel:
    """`fit`, of one input and output, with a step of `period_s`, a whole part of its own; its input held meanwhile.

    CheckFailed for what has no such form, or more states than the loop has room for.
    """
    ratio = fit.dt / period_s
    steps = round(ratio)
    if steps < 1 or abs(ratio - steps) > _WHOLE * ratio:
        raise CheckFailed(
            f"the model has a step of {fit.dt:.6g} s, the loop one of {period_s:.6g} s: give --dt, or record at a rate "
            "of which the loop's is a whole multiple"
        )
    if np.any(fit.modes.D):
        raise CheckFailed(
            "the output answers within the same row, which no stage does: are both columns of the same moment?"
        )
    poles = fit.modes.poles
    if steps > 1 and np.any((np.abs(poles.imag) < 1e-12) & (poles.real <= 0.0)):
        raise CheckFailed(f"a pole at half the model's rate has no place between its steps: record faster, or {_LESS}")
    finer = poles ** (1.0 / steps)
    gain = (finer - 1.0) / (poles - 1.0)
    A, B, C, _ = Modes(finer, fit.modes.B * gain[:, None], fit.modes.C, fit.modes.D).state_space()
    try:
        return LinearModel(
            A=tuple(tuple(map(float, row)) for row in A),
            B=tuple(map(float, B[:, 0])),
            C=tuple(map(float, C[0])),
            delay_cycles=fit.delays[0] * steps,
        )
    except ValidationError as problem:
        raise CheckFailed(f"{problem.errors()[0]['msg'].removeprefix('Value error, ')}; {_LESS}") from problem


def with_model(source: Source, axis: str, fit: LinearFit) -> str:
    """The text of `source` with `fit` as the outer loop's model of `axis`, whose weights stay or are the defaults.

    Raises CheckFailed as `per_cycle` does, and ConfigError where `check` would refuse it.
    """
    before = prepared(source)
    configuration = before.configuration
    model = per_cycle(fit, 1.0 / configuration.loop.rate_hz)
    outer = configuration.axes[axis].outer
    if outer is not None:
        outer = outer.model_copy(update={"model": model})
    elif f"stage_{axis}" not in configuration.signals:
        raise CheckFailed(f"{source.path}: axis {axis} has no signal stage_{axis}: without it no outer loop runs")
    else:
        timing = sensor_timing(configuration, before.wiring, "stage", axis)
        outer = Outer(model=model, sample_cycles=cycles_between(configuration, timing))
    text = with_outer(source.text, axis, outer)
    prepared(Source.parse(source.path, text))
    return text
