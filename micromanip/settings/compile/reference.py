"""The reference of one axis as the loop reads it, and the samples that the source `file` plays."""

from __future__ import annotations

import functools
import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.joints import FollowedJoints, followed_joints
from micromanip.control.predictor import stationary, tracker_gain
from micromanip.files import open_regular
from micromanip.rt.laws import reference as law
from micromanip.rt.records import MAX_AXES
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import AxisTracker, File, Hold, Jog, Reference, Sines, Step, Tracker
from micromanip.settings.text.source import Source

_gain = functools.lru_cache(8)(tracker_gain)
_followed = functools.lru_cache(8)(followed_joints)
"""Of the axes: those of which nothing of their own is said have the same."""
_JOG_SMOOTHING_S = 0.05
_MOST_BYTES = 500_000_000
_MOST_ROWS = 40_000_000
"""An hour and more at 10 kHz; the samples are kept in memory."""


def fill_reference(r: Any, reference: Reference, column: int, axis: str, rate_hz: int) -> None:
    """Fill a REFERENCE_PARAMETERS record for `axis`, whose samples of a file stand in `column`."""
    r["jump_um"] = math.inf
    if isinstance(reference, Tracker):
        r["kind"] = law.SIGNAL
        fill_predictor(r, reference.of(axis))
        r["horizon_s"] = reference.horizon_ms * 1e-3
        r["horizon_cycles"] = round(r["horizon_s"] * rate_hz)
        r["low_um"], r["high_um"] = reference.range_um
        r["jump_um"] = math.inf if reference.jump_um is None else reference.jump_um
        return
    if isinstance(reference, File):
        r["kind"], r["column"], r["samples_per_s"] = law.SAMPLES, column, rate_hz
        return
    r["offset_um"], r["start_s"] = reference.offset_um, reference.start_s
    if isinstance(reference, Hold):
        r["kind"] = law.HOLD
    elif isinstance(reference, Jog):
        r["kind"] = law.JOG
        r["target_um"] = reference.target_um.get(axis, reference.offset_um)
        r["speed_um"] = reference.speed_um_per_s / rate_hz
        r["smoothing"] = -math.expm1(-1.0 / (_JOG_SMOOTHING_S * rate_hz))
    elif isinstance(reference, Step):
        r["kind"], r["step_um"] = law.STEP, reference.step_um
    elif isinstance(reference, Sines):
        r["kind"], r["sines"] = law.SINES, len(reference.sines)
        for k, sine in enumerate(reference.sines):
            r["amplitude_um"][k] = sine.amplitude_um
            r["omega"][k] = 2 * math.pi * sine.frequency_Hz
            r["phase"][k] = math.radians(sine.phase_deg)


def fill_predictor(r: Any, tracker: AxisTracker) -> None:
    """Fill what a REFERENCE_PARAMETERS record has of the filter of `tracker`."""
    modes = len(tracker.oscillations)
    r["predict"], r["modes"], r["gain"][: 3 + 2 * modes] = tracker.predict, modes, _gain(tracker)
    for k, each in enumerate(tracker.oscillations):
        r["oscillator"][k], r["decay"][k] = 2 * math.pi * each.frequency_Hz, each.decay_per_s
    for name, values in zip(FollowedJoints._fields, _followed(tracker), strict=True):
        r[name][:modes] = values
    sure = tracker.sure
    r["steady"] = sure is not None
    if sure is not None:
        gain, r["steady_um2"], _ = stationary(sure)
        r["steady_gain"][: len(gain)], r["returning"] = gain, (2 * math.pi * sure.returns_Hz) ** 2
        own = _followed(sure)
        r["steady_pull"][:modes], r["steady_floor_um2"][:modes] = own.detuning_pull, own.swing_floor_um2


def load_samples(configuration: Configuration, source: Source) -> NDArray[np.float64]:
    """Samples (n, MAX_AXES) in um, one a loop cycle; zeros for any other source.

    What is learned has room in them for a part: a row per cycle for what is played, and one for its path.
    """
    reference, learning = configuration.reference, configuration.learning
    if learning is not None:
        return np.zeros((2 * round(learning.seconds * configuration.loop.rate_hz), MAX_AXES))
    if not isinstance(reference, File):
        return np.zeros((1, MAX_AXES))
    path = Path(source.path).parent / reference.path
    key = ("reference", "path")
    try:
        with io.TextIOWrapper(open_regular(path, _MOST_BYTES), encoding="utf-8") as file:
            names = file.readline().strip().split(",")
            rows = [row for row in file if row.partition("#")[0].strip()]
        table = np.loadtxt(rows, delimiter=",", ndmin=2) if rows else np.empty((0, len(names)))
    except (OSError, ValueError) as problem:
        raise source.error(
            key, f"{reference.path} can't be read as a CSV of numbers with a header: {problem}"
        ) from problem
    missing = [name for name in configuration.axes if name not in names]
    if missing:
        raise source.error(key, f"{reference.path} has no column {missing[0]}; its columns are {', '.join(names)}")
    if table.shape[1] != len(names):
        raise source.error(key, f"{reference.path} has {len(names)} names in its header and {table.shape[1]} columns")
    if len(table) < 2 or not np.isfinite(table).all():
        raise source.error(key, f"{reference.path} needs at least two rows of finite numbers")
    duration_s = (len(table) - 1) / reference.sample_rate_Hz
    if duration_s * configuration.loop.rate_hz >= _MOST_ROWS:
        raise source.error(
            ("reference", "sample_rate_Hz"),
            f"at {reference.sample_rate_Hz:g} rows per second {reference.path} lasts {duration_s:.6g} s, more than the "
            f"{_MOST_ROWS / configuration.loop.rate_hz:.6g} s that fit",
        )
    taken = np.arange(len(table)) / reference.sample_rate_Hz
    wanted = np.arange(round(duration_s * configuration.loop.rate_hz) + 1) / configuration.loop.rate_hz
    samples = np.zeros((len(wanted), MAX_AXES))
    for i, name in enumerate(configuration.axes):
        samples[:, i] = np.interp(wanted, taken, table[:, names.index(name)])
    return samples
