"""Pictures of docs/linear.md: the stage's linear dynamics, fitted to the simulated cell in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from micromanip.design.excitation import band_noise
from micromanip.design.experiment import with_axes, with_reference
from micromanip.design.linear.experiments import LinearRecord
from micromanip.design.linear.figures import bode, free_run
from micromanip.design.linear.judged import fit_records
from micromanip.settings.check import Prepared
from micromanip.settings.schema.reference import File
from micromanip.virtual.experiment import VirtualExperiment

_SAMPLES, _SETTLE = 60_000, 3000


def noise_record(prepared: Prepared, seed: int) -> LinearRecord:
    """What out/record.py of the page writes: axis x, its set-point excited with the strain loop closed."""
    strain = with_axes(prepared.configuration, mode="strain")
    excited = with_reference(strain, File(source="file", path="(excitation)"))
    samples = np.tile([axis.centre_um for axis in strain.axes.values()], (_SAMPLES, 1))
    samples[:, 0] += band_noise(rms=1.5, cutoff_hz=400.0, rate_hz=10_000, samples=_SAMPLES, seed=seed)
    axis = VirtualExperiment(prepared)(excited, seconds=6.0, samples=samples)["axis"][_SETTLE:, 0]
    u, y = axis["setpoint_um"][:, None].copy(), axis["stage_um"][:, None].copy()
    return LinearRecord(Path(f"noise{seed}.csv"), ("setpoint_um",), ("stage_um",), u, y, 1e-4)


def linear_fit(prepared: Prepared) -> Iterator[tuple[str, Figure]]:
    """The page's second fit: order 4, judged on the record that it has not seen."""
    fitted, other = (noise_record(prepared, seed) for seed in (1, 2))
    result = fit_records([fitted], other, 4, 1.0)
    yield "linear_response", bode(result, 0, 0)
    yield "linear_free_run", free_run(result)
