"""Experiments in virtual time: each on a fresh copy, bit for bit the same; and actuators with a past."""

from types import SimpleNamespace

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.bus.driver import Channel
from micromanip.design.experiment import with_axes, with_axis, with_reference
from micromanip.design.validate import paper
from micromanip.rt.records import MAX_AXES
from micromanip.rt.states import DISARM, READY
from micromanip.rt.telemetry import ROW
from micromanip.settings.check import prepare
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.reference import File, Hold, Step
from micromanip.virtual.experiment import VirtualExperiment
from micromanip.virtual.own_time import at_own_time

PERIOD_NS, COUNT = 100_000, 400


def bench(inputs=(), outputs=()):
    """As much of a configuration and its wiring as tells rates and ways; one axis."""
    entry = SimpleNamespace(driver="d", channel=None)
    configuration = SimpleNamespace(
        axes={"x": None},
        signals={"strain_x": entry, "stage_x": entry},
        outputs={"voltage_x": entry},
        loop=SimpleNamespace(rate_hz=10_000, period_ns=PERIOD_NS),
    )
    return configuration, SimpleNamespace(drivers={"d": SimpleNamespace(slow_inputs=inputs, slow_outputs=outputs)})


def truth(t_s):
    return 30.0 + 2.0 * np.sin(2 * np.pi * 20.0 * t_s)


def recorded(every, late):
    """Rows with a gauge that is fresh every `every` cycles, seen `late` cycles after its sample was taken."""
    rows = np.zeros(COUNT, ROW)
    rows["time_ns"] = (np.arange(COUNT) + 1) * PERIOD_NS
    rows["cycle"] = np.arange(COUNT) + 1
    axis = rows["axis"][:, 0]
    axis["voltage_V"] = np.arange(COUNT)
    for k in range(COUNT):
        taken = max(0, (k - late) // every * every)
        axis["strain_um"][k], axis["stage_um"][k] = truth(taken * 1e-4), -truth(taken * 1e-4)
        axis["strain_age_ns"][k] = axis["stage_age_ns"][k] = (k - taken) * PERIOD_NS
        axis["fresh"][k] = 3 if k >= late and (k - late) % every == 0 else 0
    return rows


@pytest.mark.parametrize(("every", "late"), [(5, 4), (10, 12)])
def test_late_samples_stand_where_they_were_taken(every, late):
    rate = 10_000.0 / every
    inputs = tuple(Channel(name, rate, late * 1e-4) for name in ("strain_x", "stage_x"))
    rows = recorded(every, late)
    moved = at_own_time(rows, *bench(inputs))["axis"][:, 0]
    expected = truth(np.arange(COUNT) * 1e-4)
    inside = slice(0, COUNT - every - late)
    assert np.abs(moved["strain_um"] - expected)[inside].max() < 0.01
    assert np.abs(moved["stage_um"] + expected)[inside].max() < 0.01
    assert np.abs(rows["axis"]["strain_um"][:, 0] - expected)[inside].max() > 0.1
    assert (moved["voltage_V"] == np.arange(COUNT)).all()


def test_a_sample_that_a_wire_brings_late_stands_where_it_was_taken():
    """Waited for, a frame is of its own cycle, but for some; the gauge of these stood still in the record."""
    rows = recorded(1, 0)
    axis, late = rows["axis"][:, 0], np.arange(40, COUNT - 1, 7)
    for sensor in ("strain", "stage"):
        axis[f"{sensor}_um"][late] = axis[f"{sensor}_um"][late - 1]
        axis[f"{sensor}_age_ns"][late] = PERIOD_NS
    axis["fresh"][late] = 0
    moved = at_own_time(rows, *bench())["axis"][:, 0]
    expected = truth(np.arange(COUNT) * 1e-4)
    assert np.abs(moved["strain_um"] - expected).max() < 0.001
    assert np.abs(rows["axis"]["strain_um"][:, 0] - expected).max() > 0.01
    assert (moved["voltage_V"] == np.arange(COUNT)).all()


def test_sensors_go_on_while_cycles_are_missed_and_the_voltage_does_not():
    rows = recorded(1, 0)
    seen = np.arange(COUNT)
    for begin in (50, 200):
        seen[begin : begin + 12] = begin - 1
    rows = rows[seen]
    moved = at_own_time(rows, *bench())["axis"][:, 0]
    expected = truth(np.arange(COUNT) * 1e-4)
    assert np.abs(moved["stage_um"] + expected).max() < 0.01
    assert np.abs(rows["axis"]["stage_um"][:, 0] + expected).max() > 0.1
    assert (moved["voltage_V"] == rows["axis"]["voltage_V"][:, 0]).all()


PREPARED = prepare(CONFIG / "simulated.yaml")
SECONDS, EVERY = 40.0, 100


def true_position(configuration):
    """True position (um) of all axes, a row each 10 ms."""
    return VirtualExperiment(PREPARED)(configuration, SECONDS, every=EVERY)["axis"]["true_strain_um"]


def rate(position, around_s, width_s=2.0):
    """Slope (um/s) over `width_s` around a time."""
    first, last = round((around_s - width_s / 2) * 100), round((around_s + width_s / 2) * 100)
    return np.polyfit(np.arange(last - first) * 0.01, position[first:last], 1)[0]


def test_open_loop_creeps_as_in_the_paper():
    stepped = with_reference(
        with_axes(PREPARED.configuration, mode="voltage"), Step(source="step", offset_um=20.0, step_um=90.0)
    )
    position = true_position(stepped)
    # 0.02 um/s some tens of seconds after the step, less and less
    assert (rate(position, 10.0) > 0.02).all()
    assert (rate(position, 35.0) < 0.02).all()
    assert (rate(position, 35.0) > 0.005).all()


def test_integral_action_removes_it():
    held = with_reference(with_axes(PREPARED.configuration, mode="strain"), Hold(source="hold", offset_um=90.0))
    position = true_position(held)
    assert np.abs(position[100:].mean(axis=0) - 90.0).max() < 0.02
    assert np.abs(rate(position, 20.0, width_s=30.0)).max() < 0.0005  # a fortieth of what creeps in open loop
    assert np.abs(position[3000:].mean(axis=0) - position[100:1000].mean(axis=0)).max() < 0.01


SIMULATED = CONFIG / "simulated.yaml"


@pytest.fixture(scope="module")
def prepared():
    return prepare(SIMULATED)


def test_an_experiment_leaves_nothing_behind_for_the_next(prepared):
    experiment = VirtualExperiment(prepared)
    first = experiment(prepared.configuration, 0.3)
    other = experiment(with_axes(prepared.configuration, centre_um=60.0), 0.3)
    assert experiment(prepared.configuration, 0.3).tobytes() == first.tobytes()
    assert other.tobytes() != first.tobytes()
    assert VirtualExperiment(prepare(SIMULATED))(prepared.configuration, 0.3).tobytes() == first.tobytes()


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
