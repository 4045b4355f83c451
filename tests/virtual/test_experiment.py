"""Experiments in virtual time: each on a fresh copy, bit for bit the same; and actuators with a past."""

from pathlib import Path

import numpy as np
import pytest

from micromanip.design.experiment import with_axes, with_axis, with_reference
from micromanip.design.validate import paper
from micromanip.rt.records import MAX_AXES
from micromanip.rt.states import DISARM, READY
from micromanip.settings.check import prepare
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.reference import File
from micromanip.virtual.experiment import VirtualExperiment

CONFIG = Path(__file__).parents[2] / "config" / "simulated.yaml"


@pytest.fixture(scope="module")
def prepared():
    return prepare(CONFIG)


def test_an_experiment_leaves_nothing_behind_for_the_next(prepared):
    experiment = VirtualExperiment(prepared)
    first = experiment(prepared.configuration, 0.3)
    other = experiment(with_axes(prepared.configuration, centre_um=60.0), 0.3)
    assert experiment(prepared.configuration, 0.3).tobytes() == first.tobytes()
    assert other.tobytes() != first.tobytes()
    assert VirtualExperiment(prepare(CONFIG))(prepared.configuration, 0.3).tobytes() == first.tobytes()


def test_the_process_is_left_out_unless_asked_for(prepared):
    after_force_s = 3.0
    idle, cutting = (
        VirtualExperiment(prepared, process=process)(prepared.configuration, after_force_s, every=10)["axis"]
        for process in (False, True)
    )
    quiet, loud = (rows["path_error_um"][-5000:].std(axis=0) for rows in (idle, cutting))
    assert (loud > 1.2 * quiet).all()
    # uncompensated includes what the force would do: some 40 um, here towards larger deviations
    assert np.abs(np.mean((cutting["uncompensated_um"] - idle["uncompensated_um"])[-2000:], axis=0)).min() > 20.0


PASTS = {"high": [140.0], "low": [-20.0], "many turns": [120.0, 10.0, 95.0, -15.0, 133.0, 40.0, 70.0]}


def with_a_past(prepared, corners):
    """A cell whose actuators were driven from corner to corner (V) in open loop and parked again."""
    way = np.interp(np.arange(2000 * (len(corners) + 1)), 2000 * np.arange(len(corners) + 2), [0.0, *corners, 0.0])
    played = with_reference(with_axes(prepared.configuration, mode="voltage"), File(source="file", path="(past)"))
    cell = VirtualExperiment(prepared).cell(played, np.tile(way[:, None], (1, MAX_AXES)))
    cell.arm()
    cell.run(len(way) * 1e-4)
    cell.run(1.1, command=DISARM)
    assert cell.state[0]["state"] == READY
    return cell


@pytest.mark.parametrize("past", PASTS.values(), ids=PASTS)
def test_feedforward_after_an_unknown_history(prepared, past):
    """What the actuator's memory holds is not known at arming: the sweep wipes it, as good as in a new cell."""
    frequency_hz = 5.0
    configuration = with_axes(prepared.configuration, mode="strain")
    for name, axis in configuration.axes.items():
        inner = paper.ANCHOR_PID.model_copy(update={"mode": "pid+feedforward"})
        configuration = with_axis(configuration, name, inner=inner, hysteresis=axis.hysteresis)
    configuration = with_reference(configuration, paper.reference(frequency_hz, 0.5))
    cell = with_a_past(prepared, past)
    cell.parameters[:] = compile_cell(configuration, prepared.wiring)
    arming = cell.arm()
    voltage = arming["axis"]["voltage_V"]
    assert np.abs(np.diff(voltage, axis=0)).max() < 1.0  # nothing jumps, whatever is believed of the memory
    error = strain_error(cell.run(2.5))
    fresh = strain_error(VirtualExperiment(prepared)(configuration, 2.5))
    assert (error.std(axis=0) <= 1.1 * fresh.std(axis=0)).all()
    assert np.abs(error).max() <= paper.MAXIMUM_UM["C"][frequency_hz]


def strain_error(rows):
    """Error at the gauge (um), all axes, once the sine has settled."""
    return (rows["axis"]["reference_um"] - rows["axis"]["strain_um"])[15_000:]
