"""Rows of an experiment behind a bus: every sample at its own time, every voltage when it is in force."""

from types import SimpleNamespace

import numpy as np
import pytest

from micromanip.bus.driver import Channel
from micromanip.rt.telemetry import ROW
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
