"""Samples that come rarely and late, as over a bus: what the loop makes of them."""

import math

import numpy as np
import pytest

from micromanip.rt.errors import ease_times, remember_setpoint, stage_error, strain_error
from micromanip.rt.laws.estimator import INPUT_HISTORY
from micromanip.rt.states import COASTING, FALLBACK, NO_FAULT, OSCILLATION, TRACKING
from micromanip.settings.compile.limits import fill_axis_limits
from micromanip.settings.schema.faults import AxisFaults, Oscillation
from micromanip.settings.schema.reference import Hold

from .bench_cell import BenchCell, Y, forgive, parameters

REFERENCE = Hold(source="hold", offset_um=0.0)


class SlowCell(BenchCell):
    """The gauge of axis y is fresh every `every` cycles, `late` cycles after it was read."""

    def __init__(self, every, late, record=None):
        super().__init__(record)
        self._every, self._late = every, late
        self._readings = []

    def arm(self):
        self.run(60)  # until the first sample has arrived
        return super().arm()

    def _put(self, role, i, value):
        if (role, i) != ("strain", Y):
            super()._put(role, i, value)
            return
        self._readings.append((value, self.now_ns))
        taken = len(self._readings) - 1 - self._late
        if taken >= 0 and taken % self._every == 0 and self.spoiled.get((role, i), 0) is not None:
            signal = self.signals[self.p["axis"][i][role]]
            signal["value"], signal["time_ns"] = self._readings[taken]
            signal["sequence"] += 1


def gently(tracking=0.1, answer_cycles=0):
    """Parameters with a PID for slow samples on axis y, and ages that allow them."""
    record = parameters()
    y = record[0]["axis"][Y]
    y["strain_age_ns"], y["answer_cycles"] = 100_000_000, answer_cycles
    pid = y["pid"]
    pid["K_V_per_um"], pid["derivative"], pid["tracking"] = 0.05, 0.0, tracking
    pid["integral"], pid["most_periods"] = 0.02, 1000
    y["fallback"] = pid
    return record


def swinging(frequency_Hz, tracking=0.1):
    """The same with a faster sine on axis y: a turn takes fewer cycles."""
    record = gently(tracking)
    record[0]["axis"][Y]["reference"]["omega"][0] = 2 * math.pi * frequency_Hz
    return record


def watch_band(axis, low_Hz, high_Hz, rate_hz):
    """Watch for a swing of 1 um rms in a band; the gauge gives so many samples a second."""
    band = Oscillation(band_Hz=(low_Hz, high_Hz), limit_um=1.0, time_ms=20.0)
    fill_axis_limits(axis, AxisFaults(oscillation=band), REFERENCE, 10_000, rate_hz, 1, None)
    forgive(axis)
    axis["watch"]["band_um"] = 1.0


# -- a sample and the set-point of its own time -----------------------------------------------------------


def moved(record=None):
    """An axis whose set-point was 10, 20, 30, ... um in the cycles 1, 2, 3, ... 20."""
    cell = BenchCell(record)
    a = cell.s["axis"][Y]
    for cycle in range(1, 21):
        a["setpoint_um"], a["reference"]["w"][0] = 10.0 * cycle, 1.0 * cycle
        remember_setpoint(a, cycle)
    return cell.p["axis"][Y], a


@pytest.mark.parametrize(
    ("age_us", "way", "wanted"), [(0, 0, 200.0), (100, 0, 190.0), (540, 0, 150.0), (560, 0, 140.0), (300, 4, 130.0)]
)
def test_the_gauge_is_compared_with_the_set_point_it_answers_to(age_us, way, wanted):
    p, a = moved()
    p["answer_cycles"], a["strain"]["age_ns"], a["strain"]["value"] = way, age_us * 1000, 7.0
    assert strain_error(p, a, 20) == wanted - 7.0


@pytest.mark.parametrize(("awaited", "wanted"), [(0.0, 190.0), (0.25, 187.5), (3.0, 160.0), (3.9, 151.0)])
def test_what_actuator_and_gauge_take_is_awaited_to_a_part_of_a_cycle(awaited, wanted):
    """On the line between the set-points of two cycles; the bus' way and the sample's age come on top."""
    p, a = moved()
    a["awaited_cycles"], a["strain"]["age_ns"], a["strain"]["value"] = awaited, 100_000, 7.0
    assert strain_error(p, a, 20) == pytest.approx(wanted - 7.0)
    p["answer_cycles"] = 4
    assert strain_error(p, a, 20) == pytest.approx(wanted - 47.0)


def test_times_that_are_changed_come_gently_and_arrive():
    """By a hundredth of the time that passes, so that no set-point runs by more than 1 % faster for it."""
    p, a = moved()
    p["awaited_cycles"], p["preview_s"] = 3.33, 2.72e-4
    seen = []
    for _ in range(400):
        ease_times(p, a)
        seen.append((float(a["awaited_cycles"]), float(a["preview_s"])))
    assert np.diff(seen, axis=0).max(axis=0) == pytest.approx([0.01, 0.01 * 1e-4])
    assert seen[-1] == (3.33, 2.72e-4)
    p["awaited_cycles"], p["preview_s"] = 0.0, 0.0
    for _ in range(400):
        ease_times(p, a)
    assert (a["awaited_cycles"], a["preview_s"]) == (0.0, 0.0)


def test_the_stage_is_compared_with_the_reference_of_its_time():
    p, a = moved()
    p["answer_cycles"], a["stage"]["age_ns"], a["stage"]["value"] = 4, 300_000, 0.5
    assert stage_error(p, a, 20) == (16.5, 17.0)


@pytest.mark.parametrize("skipped", [3, 10 * INPUT_HISTORY])
def test_in_skipped_cycles_the_set_point_stood(skipped):
    p, a = moved()
    cycle = 20 + skipped
    a["setpoint_um"] = -1.0
    remember_setpoint(a, cycle)
    a["strain"]["age_ns"] = 100_000
    assert strain_error(p, a, cycle) == 200.0
    a["strain"]["age_ns"] = 0
    assert strain_error(p, a, cycle) == -1.0


@pytest.mark.many_cycles
def test_a_moving_set_point_is_no_error_of_late_samples():
    """Compared with the set-point of now, the PID would lead it by speed times delay."""
    leads = []
    for compared in ("then", "now"):
        cell = SlowCell(10, 12, swinging(10.0))
        cell.arm()
        if compared == "now":  # a gauge that takes for fresh what is late
            cell.p["axis"][Y]["cycles_per_ns"] = 0.0
        cell.run(500)
        lead = []
        for _ in range(1000):
            cell.step()
            lead.append(cell.strain[Y] - float(cell.s["axis"][Y]["setpoint_um"]))
        leads.append(float(np.std(lead)))
    # 20 um at 10 Hz move by 1.5 um rms in 12 cycles and 5 more, the mean wait for the next sample
    assert leads[1] > 1.0
    assert leads[0] < leads[1] - 0.5


# -- the PID between its samples ---------------------------------------------------------------------------


def test_what_passed_while_the_gauge_was_given_up_is_not_integrated():
    record = gently()
    y = record[0]["axis"][Y]
    y["strain_age_ns"], y["watch"]["coast_cycles"] = 300_000, 1000
    cell = SlowCell(1, 0, record)
    cell.arm()
    cell.run(50)
    cell.spoiled["strain", Y] = None
    cell.run(100)
    assert cell.s["watch"][Y]["coast"] > 0
    assert cell.s["watch"][Y]["raised"] & (1 << COASTING)
    pid, p = cell.s["axis"][Y]["pid"], cell.p["axis"][Y]["pid"]
    integrator = float(pid["integrator"])
    cell.spoiled.clear()
    cell.step()
    assert cell.s["watch"][Y]["coast"] == 0
    assert pid["integrator"] == pytest.approx(integrator + p["integral"] * pid["error"], abs=1e-9)


# -- what is watched ---------------------------------------------------------------------------------------


@pytest.mark.many_cycles
@pytest.mark.parametrize(("every", "late"), [(5, 8), (10, 22)])
def test_held_samples_are_no_oscillation(every, late):
    """A fast set-point and a slow gauge make a staircase of errors, in the very band that is watched."""
    record = swinging(20.0)
    y = record[0]["axis"][Y]
    watch_band(y, 300.0, 1500.0, 10_000.0 / every)
    cell = SlowCell(every, late, record)
    cell.arm()
    cell.run(1500)
    assert (cell.s["state"], cell.s["fault"]) == (TRACKING, NO_FAULT)
    assert cell.s["watch"][Y]["band_energy"] < 0.25
    assert not cell.s["watch"][Y]["raised"] & (1 << FALLBACK)


@pytest.mark.parametrize(
    ("late", "integral", "band_Hz"), [(5, 0.35, (300.0, 1500.0)), (15, 0.15, (100.0, 400.0)), (45, 0.06, (30.0, 150.0))]
)
def test_a_swing_of_a_slow_loop_is_noticed(late, integral, band_Hz):
    """From one sample to the next, or slower, as the delay has it; the fallback gains are no better here."""
    record = gently()
    y = record[0]["axis"][Y]
    watch_band(y, *band_Hz, 1000.0)
    for gains in (y["pid"], y["fallback"]):
        gains["integral"] = integral
    cell = SlowCell(10, late, record)
    cell.arm()
    for _ in range(3000):
        cell.step()
        if cell.s["fault"] != NO_FAULT:
            break
    assert (cell.s["fault"], cell.s["fault_axis"]) == (OSCILLATION, Y)
