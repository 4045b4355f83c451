"""Multisines of `analyse live` on a simulated cell, held, in virtual time."""

import numpy as np

from micromanip.design.analyse.live_margins import DRAWS
from micromanip.design.identify.response import of_spectra
from micromanip.rt.states import HOLD
from micromanip.settings.excitation_plan import COLUMNS, plan_excitation
from micromanip.virtual.experiment import VirtualExperiment
from micromanip.virtual.own_time import at_own_time

_SETTLE_S, _AFTER_S = 1.0, 0.1


def measure_virtually(prepared, axis, loop, amplitude_um, seed=1):
    """The response of a loop's plant on the simulated cell as it is configured."""
    configuration = prepared.configuration
    experiment, index = VirtualExperiment(prepared), list(configuration.axes).index(axis)
    path = experiment.path(configuration, axis)
    cell = experiment.cell(configuration, prepared.samples)
    cell.arm()
    cell.run(_SETTLE_S, command=HOLD)
    found = []
    for draw in range(DRAWS):
        wave = plan_excitation(configuration, path, axis, loop, amplitude_um, seed + draw)
        found.append(_one_draw(prepared, cell, wave, loop, index, draw + 1))
    assert not cell.faults()
    U, Y = (np.stack([spectra[k] for spectra in found]) for k in range(2))
    return of_spectra(wave.frequency_Hz, U, Y)


def _one_draw(prepared, cell, wave, loop, index, number):
    wave.fill(cell.parameters[0]["axis"][index]["excitation"], number)
    rows = cell.run(wave.cycles / wave.rate_hz + _AFTER_S)
    moved = at_own_time(rows, prepared.configuration, prepared.wiring)["axis"][:, index]
    columns = np.column_stack([np.asarray(moved[name], dtype=float) for name in COLUMNS[loop]])
    return wave.spectra(rows["cycle"] - rows["cycle"][0], columns)
