"""Pictures of the fit in docs/record-and-replay.md, in virtual time."""

from __future__ import annotations

import tempfile
from pathlib import Path

from micromanip.design.data import load_record
from micromanip.design.experiment import open_loop
from micromanip.design.identify.experiments import DEFAULT_SECONDS, Kind, design, recording, samples_for, write_csv
from micromanip.design.identify.fitting import Request, fit_record
from micromanip.design.plots.findings import draw_fit
from micromanip.recordings import TimeSeries, Wanted
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

AXIS = "x"
_SHOWN = ("figure5_model.svg", "residuals.svg")


def record(config: Path, folder: Path, kind: Kind, seed: int = 1) -> TimeSeries:
    """What ``micromanip identify`` records of the axis, read as ``micromanip fit`` reads it."""
    prepared = prepare(config)
    configuration = prepared.configuration
    excitation = design(configuration, AXIS, kind, DEFAULT_SECONDS[kind], seed)
    seconds = len(excitation.samples) / configuration.loop.rate_hz
    rows = VirtualExperiment(prepared)(open_loop(configuration), seconds, samples_for(configuration, excitation))
    file = folder / f"{kind}_{seed}.csv"
    write_csv(file, recording(configuration, excitation, rows))
    return load_record(file, Wanted(("voltage_V", "strain_um")))


def identification_drawings(config: Path, pictures: Path) -> None:
    """Draw them into the folder `pictures`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fitted_to, held_out = record(config, folder, "multisine"), record(config, folder, "multisine", seed=2)
        result = fit_record(fitted_to, held_out, Request("pi-tanh", burn_in_s=1.0))
        for file in draw_fit(result, fitted_to, held_out, folder):
            if file.name in _SHOWN:
                (pictures / f"identification_{file.name}").write_bytes(file.read_bytes())
