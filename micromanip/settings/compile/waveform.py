"""Samples for the reference source `file`: a CSV brought to the loop's rate."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.files.regular_file import open_regular
from micromanip.rt.records import MAX_AXES
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import File
from micromanip.settings.text.source import Source

_MOST_BYTES = 500_000_000
_MOST_ROWS = 40_000_000
"""An hour and more at 10 kHz; the samples are kept in memory."""


def load_samples(configuration: Configuration, source: Source) -> NDArray[np.float64]:
    """Samples (n, MAX_AXES) in um, one a loop cycle; (1, MAX_AXES) of zeros for any other source."""
    reference = configuration.reference
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
