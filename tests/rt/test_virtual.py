"""The whole loop on the simulated cell in virtual time: reproducible, and bumpless when parameters are swapped."""

from dataclasses import replace

import numpy as np
import pytest
from micromanip_drivers.simulated.driver import SimulatedCell

from micromanip.design.experiment import with_axes
from micromanip.rt.shadow import swap_cell
from micromanip.rt.states import TRACKING
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.actuator import Actuator, Resonance
from micromanip.settings.schema.axis import Inner
from micromanip.settings.schema.hysteresis import NoModel
from micromanip.settings.schema.reference import Sine, Sines
from micromanip.virtual.cell import VirtualCell

from .bench_cell import prepared

pytestmark = pytest.mark.compiled_only  # the drivers of a virtual cell are C functions

ACTUATOR = Actuator(
    delay_us=190.0,
    gauge_us=64.0,
    lag_us=177.0,
    feedback_percent=80.0,
    resonances=(
        Resonance(resonance_Hz=63.0, resonance_damping=0.04, antiresonance_Hz=67.0, antiresonance_damping=0.038),
    ),
)
NOISE_V = 0.055 * 0.6 * 2.0
"""Strain noise through gain and derivative of the PID: what the voltage moves from cycle to cycle anyway."""


def quick(configuration):
    start = configuration.start.model_copy(update={"lift_s": 0.1, "settle_s": 0.05, "authority_s": 0.1})
    return configuration.model_copy(update={"start": start})


def wiring(seed=1, tracker_noise_um=0.5):
    """That of the tuned cell, its driver with another seed or tracker."""
    given = prepared().wiring
    old = given.drivers["cell"]
    tracker = old.options.tracker.model_copy(update={"noise_um": tracker_noise_um})
    options = old.options.model_copy(update={"seed": seed, "tracker": tracker})
    return replace(given, drivers={"cell": SimulatedCell(options, old.period_ns)})


QUIET = 0.01
"""um of tracker noise where the set-point should not move for other reasons."""


def tuned(**updates):
    return quick(with_axes(prepared().configuration, **updates))


def rows_of(seed):
    cell = VirtualCell(compile_cell(tuned(), wiring(seed)), wiring(seed))
    return np.concatenate([cell.arm(), cell.run(0.2)])


def test_the_same_seed_gives_the_same_rows_bit_by_bit():
    first, second = rows_of(1), rows_of(1)
    assert len(first) > 4000
    assert first.tobytes() == second.tobytes()


# -- swap ---------------------------------------------------------------------------------------------


def changed(configuration, change):
    return compile_cell(change(configuration), wiring(), version=2)


def each(configuration, change):
    axes = {name: axis.model_copy(update=change(axis)) for name, axis in configuration.axes.items()}
    return configuration.model_copy(update={"axes": axes})


def inner(configuration, **updates):
    return each(configuration, lambda axis: {"inner": Inner(**axis.inner.model_dump() | updates)})


def outer(configuration, **updates):
    return each(configuration, lambda axis: {"outer": axis.outer.model_copy(update=updates)})


def affine(configuration):
    return each(configuration, lambda axis: {"hysteresis": axis.hysteresis_affine})


SWAPS = {
    "nothing": lambda c: c,
    "PID gain": lambda c: inner(c, K_V_per_um=0.3),
    "integral time": lambda c: inner(c, Ti_ms=1.5),
    "derivative": lambda c: inner(c, Td_ms=0.05, filter_ms=0.6),
    "notch": lambda c: inner(c, notch={"frequency_Hz": 66.0, "width_Hz": 20.0}),
    "hysteresis model": affine,
    "no hysteresis model": lambda c: inner(with_axes(c, hysteresis=NoModel(model="none")), mode="pid"),
    "feedforward alone": lambda c: inner(c, mode="feedforward"),
    "regulator": lambda c: outer(c, control_weight=30.0),
    "observer": lambda c: outer(c, disturbance_um=0.03, oscillation_um=2e-3),
    "no oscillator": lambda c: outer(c, oscillation_Hz=None),
    "actuator": lambda c: with_axes(c, actuator=ACTUATOR),
    "everything": lambda c: outer(
        inner(affine(c), K_V_per_um=0.45, Td_ms=0.1), control_weight=20.0, disturbance_um=0.05
    ),
}

MODES = {
    "stage": lambda: tuned(),
    "strain": lambda: tuned(mode="strain").model_copy(
        update={"reference": Sines(source="sine", offset_um=66.0, sines=(Sine(amplitude_um=30.0, frequency_Hz=5.0),))}
    ),
}


def swapped(configuration, new):
    """Rows of 50 ms before and 50 ms after a swap while tracking, and the cell."""
    wired = wiring(tracker_noise_um=QUIET)
    cell = VirtualCell(compile_cell(configuration, wired), wired)
    cell.arm()
    cell.run(0.15)
    before = cell.run(0.05)
    old, cell.parameters = cell.parameters, new
    swap_cell(old[0], new[0], cell.state[0])
    assert cell.state[0]["version"] == 2
    return before, cell.run(0.05), cell


def steps(before, after, name):
    """Largest change of a telemetry column from cycle to cycle: before the swap, and over it."""
    values = np.concatenate([before["axis"][name], after["axis"][name]])
    change = np.abs(np.diff(values, axis=0))
    return change[: len(before) - 1].max(axis=0), change[len(before) - 1 : len(before) + 4].max(axis=0)


@pytest.mark.parametrize("name", SWAPS)
@pytest.mark.parametrize("mode", MODES)
def test_swap_while_tracking_is_bumpless(mode, name):
    configuration = MODES[mode]()
    before, after, cell = swapped(configuration, changed(configuration, SWAPS[name]))
    assert cell.state[0]["state"] == TRACKING
    usual, over = steps(before, after, "voltage_V")
    assert (over < usual + 4 * NOISE_V).all()
    usual, over = steps(before, after, "setpoint_um")
    assert (over < 2.0 * usual + 0.02).all()
    # nor does anything run away thereafter
    gone = np.abs(after["axis"]["setpoint_um"] - before["axis"]["setpoint_um"][-1])
    assert gone.max() < np.ptp(before["axis"]["setpoint_um"], axis=0).max() + 10.0
    assert np.abs(after["axis"]["voltage_V"] - before["axis"]["voltage_V"][-1]).max() < 40.0


def other_plant(configuration):
    """Another flexure: another meaning of the states."""

    def moved(axis):
        model = axis.outer.model
        A = (tuple(0.999 * a for a in model.A[0]), *model.A[1:])
        return {"outer": axis.outer.model_copy(update={"model": model.model_copy(update={"A": A})})}

    return each(configuration, moved)


@pytest.mark.parametrize(
    ("change", "kept"),
    [(SWAPS["regulator"], 11), (SWAPS["observer"], 11), (SWAPS["no oscillator"], 9), (other_plant, 0)],
)
def test_the_estimate_is_kept_where_its_states_mean_the_same(change, kept):
    configuration = MODES["stage"]()
    cell = VirtualCell(compile_cell(configuration, wiring()), wiring())
    cell.arm()
    before = cell.state[0]["axis"][0]["estimator"].copy()
    swap_cell(cell.parameters[0], changed(configuration, change)[0], cell.state[0])
    after = cell.state[0]["axis"][0]["estimator"]
    assert after["running"] == (kept > 0)
    assert (after["x"][:kept] == before["x"][:kept]).all()
    assert (after["filtered"][:kept] == before["filtered"][:kept]).all()
    if kept:
        assert (before["x"][:11] != 0.0).all()
        assert (after["x"][kept:] == 0.0).all()


def test_feedforward_to_feedback_and_back():
    """The integrator does not come back with what it had long ago, nor with the time in between."""
    configuration = MODES["strain"]()
    alone = compile_cell(inner(configuration, mode="feedforward"), wiring())
    cell = VirtualCell(alone, wiring())
    cell.arm()
    before = cell.run(1.0)[-500:]
    new = compile_cell(configuration, wiring(), version=2)
    swap_cell(alone[0], new[0], cell.state[0])
    cell.parameters = new
    after = cell.run(0.2)
    usual, over = steps(before, after, "voltage_V")
    error = after["axis"]["setpoint_um"][-500:] - after["axis"]["strain_um"][-500:]
    assert np.abs(error).max() < 1.0
    # the feedback may act on the error it finds, no more: some um times its gains
    found = np.abs(before["axis"]["setpoint_um"][-1] - before["axis"]["strain_um"][-1]).max()
    assert (over < usual + found * 0.6 * 2.0 + 4 * NOISE_V).all()
