"""Loops that swing from end to end are stopped by X-216, whatever the limits; what only works hard is not."""

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.design.experiment import open_loop, with_axes, with_reference
from micromanip.design.validate import paper
from micromanip.errors import CheckFailed
from micromanip.faults import KINDS, FaultReport
from micromanip.rt.records import MAX_AXES
from micromanip.rt.states import FAULT, LIMIT_CYCLE, NO_FAULT, RAMPING, TRACKING
from micromanip.settings.check import prepare
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.compile.limits import NEVER
from micromanip.virtual.cell import VirtualCell
from micromanip.virtual.experiment import VirtualExperiment

from .protected import Protected

X = 0


def cell(name, change):
    """The cell of an example, with the limits of a simulation, and `change` made to the record of its axis x."""
    prepared = prepare(CONFIG / f"{name}.yaml")
    parameters = prepared.parameters.copy()
    change(parameters[0]["axis"][X])
    return VirtualCell(parameters, prepared.wiring)


def much_feedback(axis):
    axis["outer"]["feedback"] *= 100.0


def wrong_sign(axis):
    axis["outer"]["feedback"] *= -1.0


def without_limits(axis):
    """As with every limit of the section faults at null."""
    watch = axis["watch"]
    watch["following_um"] = watch["innovation_ratio"] = watch["band_um"] = np.inf
    watch["saturated_cycles"] = watch["saturating_cycles"] = NEVER
    much_feedback(axis)


@pytest.mark.parametrize("change", [much_feedback, wrong_sign, without_limits])
def test_a_loop_that_swings_from_end_to_end_is_stopped(change):
    swinging = cell("simulated", change)
    try:
        swinging.arm()
        swinging.run(4.0)
    except CheckFailed:
        swinging.run(1.0)  # it was stopped while the authority rose
    s = swinging.state[0]
    assert (s["fault"], s["fault_axis"]) == (LIMIT_CYCLE, X)
    assert s["state"] == FAULT
    assert 0.0 < s["fault_value"] <= 2.0
    assert abs(s["axis"][X]["voltage_V"]) < 0.01
    assert FaultReport(KINDS[LIMIT_CYCLE], "x", 0.3, 8.0).seen.startswith("X-216 axis x: limit cycle")


def test_a_strain_loop_that_swings_is_stopped_on_the_way_up():
    """Four times the gain that a bus of 1 kHz carries: it swings in the lift already."""

    def strong(axis):
        for gain in ("K_V_per_um", "integral", "derivative"):
            axis["pid"][gain] *= 12.0
            axis["fallback"][gain] = axis["pid"][gain]

    swinging = cell("simulated_1khz", strong)
    with pytest.raises(CheckFailed):
        swinging.arm()
    assert swinging.state[0]["fault"] == LIMIT_CYCLE
    assert swinging.state[0]["state"] in (RAMPING, FAULT)


def worst(state):
    """Most swings that were counted on any axis."""
    watch = state["watch"]
    return int(watch["swing"]["times"].max())


def test_the_paper_s_sines_are_no_limit_cycle():
    prepared = prepare(CONFIG / "simulated.yaml")
    experiment = VirtualExperiment(prepared)
    moving = with_axes(prepared.configuration, mode="strain", inner=paper.ANCHOR_PID)
    for frequency_hz in paper.FREQUENCIES_HZ:
        sine = experiment.cell(with_reference(moving, paper.reference(frequency_hz, 0.5)))
        sine.arm()
        sine.run(4.0)
        assert (sine.state[0]["state"], sine.state[0]["fault"]) == (TRACKING, NO_FAULT)
        assert worst(sine.state[0]) <= 1


def test_a_path_beyond_one_end_is_no_limit_cycle():
    """Half the voltage: the axis is at its upper end whenever the path goes there."""
    short = cell("simulated", lambda axis: axis["watch"].__setitem__("saturated_cycles", NEVER))
    short.arm()
    short.parameters[0]["axis"][X]["limiter"]["high_V"] = 60.0
    rows = short.run(8.0)
    at_end = rows["axis"]["voltage_V"][:, X] == 60.0
    assert np.count_nonzero(np.diff(at_end.astype(int)) == 1) >= 8
    assert short.state[0]["fault"] != LIMIT_CYCLE
    assert worst(short.state[0]) <= 2


def test_a_safe_cell_counts_nothing():
    guarded = Protected()
    guarded.run(1.0)
    assert worst(guarded.s) == 0


def resonating(prepared):
    """Samples that play a sine near the stage's resonance, in open loop, and how long they are (s)."""
    configuration = prepared.configuration
    seconds, rate_hz = 2.0, configuration.loop.rate_hz
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    samples = np.zeros((len(t), MAX_AXES))
    samples[:, X] = 62.0 + np.minimum(1.0, t) * 40.0 * np.sin(2 * np.pi * 65.0 * t)
    return samples, seconds


def test_a_stage_that_swings_while_it_is_identified_is_stopped():
    """In open loop, no voltage at its end, far below the slew limit: the stage goes from sensor end to sensor end."""
    prepared = prepare(CONFIG / "factory.yaml")
    samples, seconds = resonating(prepared)
    experiment = VirtualExperiment(prepared)
    with pytest.raises(CheckFailed, match=r"X-216 axis x: limit cycle.*stage"):
        experiment(open_loop(prepared.configuration), seconds, samples)
    stopped = experiment.cell(open_loop(prepared.configuration), samples)
    stopped.arm()
    rows = stopped.run(seconds)
    assert rows["state"][-1] == FAULT
    assert np.abs(np.diff(rows["axis"]["voltage_V"][:, X])).max() < 2.5


def test_a_gauge_that_fails_while_it_is_identified_ends_that(tmp_path):
    """Its axis needs it then; the gauge of an axis that rests may be unplugged."""
    text = (CONFIG / "factory.yaml").read_text(encoding="utf-8")
    for axis, ends in (("x", True), ("y", False)):
        failing = f"    seed: 1\n    faults: [{{at_s: 2.5, channel: strain_{axis}, kind: nan}}]\n"
        file = tmp_path / f"{axis}.yaml"
        file.write_text(text.replace("    seed: 1\n", failing), encoding="utf-8")
        prepared = prepare(file)
        samples = np.full((20_000, MAX_AXES), 0.0)
        samples[:, X] = 40.0
        played = VirtualExperiment(prepared).cell(open_loop(prepared.configuration), samples)
        played.arm()
        played.run(3.0)
        assert bool(played.state[0]["fault"] != NO_FAULT) == ends


def test_no_key_switches_it_off():
    prepared = prepare(CONFIG / "simulated.yaml")
    watch = compile_cell(prepared.configuration, prepared.wiring)[0]["axis"]["watch"]
    assert (watch["swings"][:3] == 8).all()
    assert (watch["swing_cycles"][:3] == 20_000).all()
