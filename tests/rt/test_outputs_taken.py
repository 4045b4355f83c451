"""Outputs of a bus that do not follow the loop: seen in the cycle in which it begins, no arming before they do."""

import pytest

from micromanip.rt.cycle import ALL_FOLLOW, FIRST_TAKEN, watch_drivers
from micromanip.rt.states import (
    ARM,
    ARMING,
    DISARM,
    FAULT,
    HOLD,
    HOLDING,
    LINK_LOST,
    NO_FAULT,
    OFF,
    OUTPUTS_MISSING,
    OUTPUTS_TAKEN,
    RAMPING,
    RAMPS,
    READY,
    RESET,
    STOP,
    TRACKING,
)

from .bench_cell import BenchCell, parameters

TAKEN_FROM_SECOND = FIRST_TAKEN - 1


class OnABus(BenchCell):
    """A cell whose drivers' exchange returns `code`."""

    def __init__(self):
        record = parameters()
        record[0]["reaction"][OUTPUTS_TAKEN] = record[0]["reaction"][LINK_LOST] = RAMPS
        self.code = 0
        super().__init__(record)

    def begin_cycle(self, missed):
        super().begin_cycle(missed)
        watch_drivers(self.p, self.s, self.code)


@pytest.fixture
def cell():
    return OnABus()


def test_tracking_ends_in_the_cycle_in_which_they_are_taken(cell):
    cell.arm()
    assert cell.s["state"] == TRACKING
    cell.code = TAKEN_FROM_SECOND
    cell.step()
    assert (cell.s["state"], cell.s["fault"], cell.s["fault_value"]) == (RAMPING, OUTPUTS_TAKEN, 1.0)
    assert cell.s["fault_cycle"] == cell.s["cycle"]


@pytest.mark.parametrize("command", [HOLD, DISARM])
def test_so_does_a_hold_and_the_fading_out_before_a_ramp(cell, command):
    cell.arm()
    cell.step(command=command)
    assert cell.s["state"] == (HOLDING if command == HOLD else RAMPING)
    cell.code = FIRST_TAKEN
    cell.step()
    assert (cell.s["state"], cell.s["soft"], cell.s["fault"]) == (RAMPING, 0, OUTPUTS_TAKEN)


def ramped(cell):
    """Armed, disarmed and at the end of the ramp, on which the outputs were taken."""
    cell.arm()
    cell.step(command=DISARM)
    while cell.s["soft"] != 0:
        cell.step()
    cell.code = FIRST_TAKEN
    cell.run(3 * int(cell.p["ramp_cycles"]))
    return cell


@pytest.mark.parametrize("code", [FIRST_TAKEN, TAKEN_FROM_SECOND, ALL_FOLLOW])
def test_on_the_ramp_it_is_no_fault_but_ready_waits_until_the_devices_rest(cell, code):
    ramped(cell).code = code
    cell.run(50)
    assert (cell.s["state"], cell.s["fault"]) == (RAMPING, NO_FAULT)
    cell.code = 0
    cell.step()
    assert (cell.s["state"], cell.s["fault"]) == (READY, NO_FAULT)


def test_outputs_that_follow_and_are_away_are_no_fault_in_any_state(cell):
    cell.code = ALL_FOLLOW
    cell.arm()
    cell.run(50)
    assert (cell.s["state"], cell.s["fault"], cell.s["outputs_taken"], cell.s["link_down"]) == (
        TRACKING,
        NO_FAULT,
        0,
        0,
    )


def test_a_stop_does_not_wait_for_the_devices(cell):
    ramped(cell).step(command=STOP)
    assert cell.s["state"] == OFF


def test_nor_does_a_fault_which_says_of_no_output_that_it_rests(cell):
    ramped(cell).code = -2
    cell.step()
    assert (cell.s["state"], cell.s["fault"]) == (FAULT, LINK_LOST)


def test_arming_waits_for_outputs_in_the_loops_hand(cell):
    cell.code = FIRST_TAKEN
    cell.run(5)
    assert not cell.step(command=ARM)
    assert (cell.s["state"], cell.s["refused"]) == (READY, OUTPUTS_MISSING)
    cell.code = 0
    assert cell.step(command=ARM)
    assert cell.s["state"] == ARMING


def test_it_is_not_taken_for_a_lost_link_nor_a_lost_link_for_it(cell):
    cell.arm()
    cell.code = -2
    cell.step()
    assert (cell.s["fault"], cell.s["fault_value"], cell.s["link_down"]) == (LINK_LOST, 1.0, 1)
    cell.code = FIRST_TAKEN
    cell.step()
    assert (cell.s["fault"], cell.s["link_down"], cell.s["outputs_taken"]) == (LINK_LOST, 0, 1)
    while cell.s["state"] == RAMPING:
        cell.step()
    assert cell.s["state"] == FAULT


@pytest.mark.parametrize("code", [FIRST_TAKEN, ALL_FOLLOW, -2])
def test_a_reset_waits_until_the_outputs_are_known_to_rest(cell, code):
    cell.arm()
    cell.code = -2
    cell.step()
    while cell.s["state"] == RAMPING:
        cell.step()
    cell.code = code
    assert not cell.step(command=RESET)
    assert cell.s["state"] == FAULT
    cell.code = 0
    assert cell.step(command=RESET)
    assert cell.s["state"] == READY
