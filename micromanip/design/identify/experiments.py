"""Identification experiments of one axis: what is played, and the recording that comes of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import Array
from micromanip.recordings import TimeSeries
from micromanip.settings.schema.model import Configuration

from ..excitation import multisine, random_turns, shrinking_triangle, soft
from ..experiment import parked

Kind = Literal["multisine", "turns", "triangle", "step"]

DEFAULT_SECONDS = {"multisine": 13.0, "turns": 60.0, "triangle": 24.0, "step": 60.0}
RECORD_RATE_HZ = 1000.0
_USED_SHARE, _WHOLE_SHARE = (0.22, 0.92), (0.05, 0.95)
_TURNS = 6
_STALE_NS = 50_000_000
"""A sample that is held for longer is none, where the signal has no limit of its own."""


@dataclass(frozen=True)
class Excitation:
    """A waveform for one axis: V, one sample a loop cycle; what begins and ends it is not to be fitted to."""

    axis: str
    kind: Kind
    samples: Array
    lead_cycles: int


def design(configuration: Configuration, axis: str, kind: Kind, seconds: float, seed: int) -> Excitation:
    """An excitation inside the voltage and slew limits of the axis' output, from and to its park voltage.

    It uses the upper three quarters of the output's range, where an actuator under preload works; random turning
    points use nearly all of it, because a network knows nothing of where it has not been.
    """
    output = configuration.outputs[f"voltage_{axis}"]
    used = _WHOLE_SHARE if kind == "turns" else _USED_SHARE
    low, high = (output.range_V[0] + share * (output.range_V[1] - output.range_V[0]) for share in used)
    rate, slew = configuration.loop.rate_hz, output.slew_V_per_ms * 1e3
    if kind == "multisine":
        wave = multisine(low, high, slew, rate, seconds, seed)
    elif kind == "turns":
        wave = random_turns(low, high, slew, rate, seconds, seed)
    elif kind == "triangle":
        travelled = (high - low) * (_TURNS + 1)
        seconds = max(seconds, 2.0 * travelled / slew)
        wave = shrinking_triangle(low, high, _TURNS, round(seconds * rate / (2 * _TURNS)))
    else:
        rise = max(1, round(2.0 * (high - low) / slew * rate))
        wave = np.concatenate([np.full(rate, low), np.linspace(low, high, rise), np.full(round(seconds * rate), high)])
    whole = soft(wave, output.park_V, rate, slew)
    return Excitation(axis, kind, whole, (len(whole) - len(wave)) // 2)


def samples_for(configuration: Configuration, excitation: Excitation) -> Array:
    """Samples (n, MAX_AXES): the excitation on its axis, the park voltage on the others."""
    samples = parked(configuration, len(excitation.samples))
    samples[:, list(configuration.axes).index(excitation.axis)] = excitation.samples
    return samples


def recording(configuration: Configuration, excitation: Excitation, rows: NDArray[Any]) -> TimeSeries:
    """The recording at about 1 kHz, without lead-in and lead-out, from `rows` (one per cycle).

    The stage sensor's is NaN while it held an old value, see `held`, and left out where there is none.
    """
    every = max(1, round(configuration.loop.rate_hz / RECORD_RATE_HZ))
    i = list(configuration.axes).index(excitation.axis)
    part = slice(excitation.lead_cycles, len(excitation.samples) - excitation.lead_cycles, every)
    columns = {name: rows["axis"][name][part, i].astype(float) for name in ("voltage_V", "strain_um")}
    old = held(configuration, excitation.axis, rows)[part]
    if not old.all():
        columns["stage_um"] = np.where(old, np.nan, rows["axis"]["stage_um"][part, i])
    return TimeSeries.of_columns(Path(f"axis {excitation.axis}"), columns, every / configuration.loop.rate_hz)


def held(configuration: Configuration, axis: str, rows: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether the stage sensor's value in each of `rows` is an old one, or none: it is out of range, dead, or late."""
    signal = configuration.signals.get(f"stage_{axis}")
    if signal is None:
        return np.ones(len(rows), dtype=bool)
    limit_ns = _STALE_NS if signal.max_age_us is None else signal.max_age_us * 1e3
    of_axis = rows["axis"][:, list(configuration.axes).index(axis)]
    return np.asarray((of_axis["stage_age_ns"] > limit_ns) | np.isnan(of_axis["stage_um"]))


def write_csv(file: Path, series: TimeSeries) -> None:
    """Write times and columns under a header, whole or not at all. Raises OSError."""
    part = file.with_name(file.name + ".part")
    try:
        table, header = np.column_stack([series.time_s, series.values]), ",".join(("t_s", *series.names))
        np.savetxt(part, table, "%.9g", ",", header=header, comments="")
        part.replace(file)
    except OSError:
        part.unlink(missing_ok=True)
        raise
