"""Draw the pictures of the fit in docs/record-and-replay.md into docs/pictures: its walk, in virtual time."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib as mpl

from micromanip.design.fit_figures import draw_fit
from micromanip.design.fitting import Request, fit_record
from micromanip.design.identification import DEFAULT_SECONDS, Kind, design, recording, samples_for, variant, write_csv
from micromanip.design.record import Record, load_record
from micromanip.recordings import Wanted
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "pictures"
CONFIG = ROOT / "config" / "factory.yaml"
AXIS = "x"
_SHOWN = ("figure5_model.svg", "residuals.svg")


def record(folder: Path, kind: Kind, seed: int = 1) -> Record:
    """What ``micromanip identify`` records of the axis, read as ``micromanip fit`` reads it."""
    prepared = prepare(CONFIG)
    configuration = prepared.configuration
    excitation = design(configuration, AXIS, kind, DEFAULT_SECONDS[kind], seed)
    seconds = len(excitation.samples) / configuration.loop.rate_hz
    rows = VirtualExperiment(prepared)(variant(configuration), seconds, samples_for(configuration, excitation))
    file = folder / f"{kind}_{seed}.csv"
    write_csv(file, recording(configuration, excitation, rows))
    return load_record(file, Wanted(("voltage_V", "strain_um")))


def main() -> None:
    """Draw everything; the same sources give the same files."""
    mpl.rcParams["svg.hashsalt"] = "micromanip"
    PICTURES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fitted_to, held_out = record(folder, "multisine"), record(folder, "multisine", seed=2)
        result = fit_record(fitted_to, held_out, Request("pi-tanh", burn_in_s=1.0))
        for file in draw_fit(result, fitted_to, held_out, folder, dpi=90):
            if file.name in _SHOWN:
                (PICTURES / f"identification_{file.name}").write_bytes(file.read_bytes())
    for file in sorted(PICTURES.glob("identification_*.svg")):
        sys.stderr.write(f"{file.relative_to(ROOT)}  {file.stat().st_size / 1000:.0f} kB\n")


if __name__ == "__main__":
    main()
