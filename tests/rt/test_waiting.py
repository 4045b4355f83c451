"""An axis whose voltage has to wait for its device: no further that way, back as ever, and on when it has followed."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micromanip.rt.axis_order import see_behind
from micromanip.rt.io.link_gate import LINK_GATE, acknowledge, has_sent, near, put_back
from micromanip.rt.states import NO_FAULT, TRACKING
from micromanip.rt.supervisor import AT_ONCE, MANY
from micromanip.rt.telemetry import DEVICE_ABOVE, DEVICE_BELOW, ROW, write_row

from .bench_cell import BenchCell

STEP_V = 4.0


class OnAWire(BenchCell):
    """The cell behind a gate; while `answers` is False none of its frames is acknowledged."""

    answers = True

    def begin(self):
        """Arm, then put the gate between."""
        self.gate = None
        self.arm()
        self.gate = np.zeros(1, LINK_GATE)[0]
        self.gate["outputs"] = 3
        self.places = [int(self.p["axis"][i]["voltage"]) for i in range(3)]
        for k, voltage in zip(self.places, self.voltages, strict=True):
            self.gate["step"][k] = STEP_V
            self.gate["lowest"][k] = self.gate["highest"][k] = self.gate["last"][k] = voltage
        return self

    def step(self, command=0, periods=1):
        if self.gate is not None:
            self.asked = list(self.voltages)
            for k in self.places:
                self.gate["last"][k] = near(self.gate, k, self.outputs[k])
            has_sent(self.gate)
            put_back(self.gate, self.outputs)
            if self.answers:
                acknowledge(self.gate, 0)
        return super().step(command, periods)

    def begin_cycle(self, missed):
        super().begin_cycle(missed)
        see_behind(self.p, self.s, self.outputs)

    @property
    def waits(self):
        return self.s["order"]["behind"][:3]


@pytest.fixture
def cell():
    return OnAWire().begin()


def test_what_is_answered_in_time_never_waits(cell):
    other = BenchCell().arm()
    for _ in range(300):
        cell.step()
        other.step()
        assert not cell.waits.any()
        assert cell.voltages == other.voltages


@pytest.mark.many_cycles
def test_an_axis_waits_near_what_its_device_has_and_goes_on_when_that_has_followed(cell):
    cell.run(100)
    cell.answers = False
    gaps_V, waited = [], np.zeros(3, int)
    for _ in range(300):
        cell.step()
        given_V = [float(cell.gate["last"][k]) for k in cell.places]
        gaps_V.append(np.abs(np.array(cell.asked) - given_V))
        waited = np.maximum(waited, np.abs(cell.waits))
    assert np.all(waited > 20)
    assert np.max(gaps_V) <= STEP_V
    cell.answers = True
    cell.run(6000)
    assert not cell.waits.any()
    assert (cell.s["state"], cell.s["fault"]) == (TRACKING, NO_FAULT)
    other = BenchCell().arm()
    other.run(6400)
    assert np.max(np.abs(np.array(cell.stage) - other.stage)) < 0.5


@pytest.mark.many_cycles
@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(1, 20)), min_size=3, max_size=12))
def test_however_it_answers_no_axis_asks_for_more_than_a_step_beyond(spells):
    cell = OnAWire().begin()
    for cell.answers, cycles in spells:
        for _ in range(cycles):
            before_um = cell.s["axis"]["setpoint_um"][:3].copy()
            cell.step()
            moved_um = cell.s["axis"]["setpoint_um"][:3] - before_um
            assert np.all(moved_um[cell.waits > 0] <= 0.0)
            assert np.all(moved_um[cell.waits < 0] >= 0.0)
            given_V = [float(cell.gate["last"][k]) for k in cell.places]
            assert np.max(np.abs(np.array(cell.asked) - given_V)) <= STEP_V
    cell.answers = True
    cell.run(60)
    assert not cell.waits.any()


def test_one_wait_however_long_is_over_when_it_is_seen(cell):
    """As one gap is: the calm gains are for many of them."""
    cell.answers = False
    cell.run(200)
    assert np.all(np.abs(cell.waits[:2]) > AT_ONCE)
    assert np.all(cell.s["axis"]["supervisor"]["missing"][:2] < MANY)


@pytest.mark.parametrize(("direction", "bit"), [(0, 0), (1, DEVICE_BELOW), (-1, DEVICE_ABOVE)])
def test_the_row_says_so(cell, direction, bit):
    row = np.zeros(1, ROW)[0]
    cell.s["order"][1]["behind"] = direction
    write_row(cell.p, cell.s, cell.signals, row, cell.now_ns, 0, 0, 1)
    assert int(row["axis"][1]["fresh"]) & (DEVICE_BELOW | DEVICE_ABOVE) == bit


def test_only_what_has_to_wait_is_put_back():
    """Not what is no number, nor what can go: the loop's own values stay."""
    gate = np.zeros(1, LINK_GATE)[0]
    gate["outputs"], gate["step"][:3] = 3, STEP_V
    outputs = np.array([3.0, -7.0, math.nan])
    for i in range(3):
        gate["last"][i] = near(gate, i, outputs[i])
    put_back(gate, outputs)
    assert outputs[:2].tolist() == [3.0, -STEP_V]
    assert math.isnan(outputs[2])
