"""The fault manager: written down, latched, answered. The whole state is compared: nothing else may change."""

import numpy as np
import pytest

from micromanip.rt.faults import EVENTS, axis_fault, begins, cell_fault, forget, note, raise_fault, react
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE
from micromanip.rt.states import (
    ARMING,
    CLOSED,
    CUTS,
    DISAGREEMENT,
    FAULT,
    FOLLOWING_ERROR,
    HOLDING,
    HOLDS,
    HOST_DEAD,
    INTERLOCK_OPEN,
    LIFTING,
    NO_FAULT,
    OFF,
    PARKING,
    RAMPING,
    RAMPS,
    READY,
    SATURATED,
    TRACKING,
    WARN,
)


def cell(state=TRACKING, **fields):
    """Parameters and state of three axes, every voltage and flag another."""
    p, s = np.zeros(1, CELL_PARAMETERS)[0], np.zeros(1, CELL_STATE)[0]
    p["axes"] = 3
    p["reaction"][INTERLOCK_OPEN] = RAMPS
    for i in range(3):
        p["axis"][i]["watch"]["reaction"][FOLLOWING_ERROR] = (HOLDS, RAMPS, WARN)[i]
        s["axis"][i]["voltage_V"], s["order"][i]["start_V"] = 10.0 + i, 1.0 + i
        s["axis"][i]["estimator"]["running"] = 1
    s["cycle"], s["entered_cycle"], s["state"] = 1000, 900, state
    for name, value in fields.items():
        s[name] = value
    return p, s


def event(k, code, axis, value, limit, reaction, state=TRACKING, cycle=1000):
    """A change of the state's event list."""

    def change(s):
        e = s["event"][k]
        e["cycle"], e["code"], e["axis"], e["value"], e["limit"] = cycle, code, axis, value, limit
        e["reaction"], e["state"] = reaction, state
        s["events"] = s["events"] + 1

    return change


def latch(code, axis, value, limit):
    def change(s):
        s["fault"], s["fault_axis"], s["fault_value"], s["fault_limit"] = code, axis, value, limit
        s["fault_cycle"] = s["cycle"]
        s["trips"] += 1

    return change


def put(**fields):
    def change(s):
        for name, value in fields.items():
            s[name] = value

    return change


def entered(state):
    return put(state=state, entered_cycle=1000)


def held(s):
    s["order"]["held_since"] = 1000
    entered(HOLDING)(s)


def ramping(s):
    s["order"]["start_V"] = s["axis"]["voltage_V"]
    s["soft"] = 0
    entered(RAMPING)(s)


def dropped(s):
    entered(FAULT)(s)


def raised(code, axis=-1):
    def change(s):
        where = s["watch"][axis] if axis >= 0 else s
        where["raised"] |= 1 << code

    return change


def expect(s, before, *changes):
    """`s` is `before` with `changes`, bit by bit."""
    for change in changes:
        change(before)
    assert s.tobytes() == before.tobytes()


def test_an_event_is_written_down():
    _, s = cell(events=3)
    before = s.copy()
    note(s, 7, 2, 1.5, 2.5, RAMPS)
    expect(s, before, event(3, 7, 2, 1.5, 2.5, RAMPS))


def test_the_newest_events_are_kept():
    _, s = cell(events=EVENTS)
    before = s.copy()
    note(s, 7, 2, 1.5, 2.5, RAMPS)
    expect(s, before, event(0, 7, 2, 1.5, 2.5, RAMPS))


@pytest.mark.parametrize(
    ("bits", "code", "active", "began", "after"),
    [
        (0b0000, 2, True, True, 0b0100),
        (0b0100, 2, True, False, 0b0100),
        (0b0100, 2, False, False, 0b0000),
        (0b0000, 2, False, False, 0b0000),
        (0b1010, 2, True, True, 0b1110),
        (0b1110, 2, False, False, 0b1010),
        (0b1010, 0, True, True, 0b1011),
        (0, 40, True, True, 1 << 40),
    ],
)
def test_a_condition_begins_once(bits, code, active, began, after):
    _, s = cell(raised=bits)
    assert bool(begins(s, code, active)) is began
    assert s["raised"] == after


def test_a_warning_is_told_each_time_it_begins():
    p, s = cell()
    before = s.copy()
    axis_fault(p, s, 2, 22, True, 3.0, 4.0)
    expect(s, before, raised(22, 2), event(0, 22, 2, 3.0, 4.0, WARN))
    before = s.copy()
    axis_fault(p, s, 2, 22, True, 5.0, 4.0)
    expect(s, before)
    axis_fault(p, s, 2, 22, False, 5.0, 4.0)
    axis_fault(p, s, 2, 22, True, 6.0, 4.0)
    assert s["events"] == 2
    assert s["event"][1]["value"] == 6.0


@pytest.mark.parametrize(("axis", "reaction", "after"), [(0, HOLDS, (held,)), (1, RAMPS, (ramping,)), (2, WARN, ())])
def test_a_fault_of_an_axis_has_the_reaction_of_that_axis(axis, reaction, after):
    p, s = cell()
    before = s.copy()
    axis_fault(p, s, axis, FOLLOWING_ERROR, True, 6.0, 5.0)
    latched = () if reaction == WARN else (latch(FOLLOWING_ERROR, axis, 6.0, 5.0),)
    expect(
        s, before, raised(FOLLOWING_ERROR, axis), event(0, FOLLOWING_ERROR, axis, 6.0, 5.0, reaction), *latched, *after
    )
    before = s.copy()
    axis_fault(p, s, axis, FOLLOWING_ERROR, True, 7.0, 5.0)
    expect(s, before)


def test_a_fault_of_the_cell():
    p, s = cell()
    before = s.copy()
    cell_fault(p, s, INTERLOCK_OPEN, False, 0.5, 2.5)
    expect(s, before)
    cell_fault(p, s, INTERLOCK_OPEN, True, 0.5, 2.5)
    expect(
        s,
        before,
        raised(INTERLOCK_OPEN),
        event(0, INTERLOCK_OPEN, -1, 0.5, 2.5, RAMPS),
        latch(INTERLOCK_OPEN, -1, 0.5, 2.5),
        ramping,
    )


def test_the_first_fault_stays_and_a_graver_one_hardens_the_reaction():
    p, s = cell()
    raise_fault(p, s, FOLLOWING_ERROR, 0, 6.0, 5.0, HOLDS)
    s["cycle"] = 1000  # the same cycle
    before = s.copy()
    raise_fault(p, s, SATURATED, 1, 7.0, 8.0, HOLDS)
    raise_fault(p, s, SATURATED, 1, 7.0, 8.0, RAMPS)
    held_on = event(1, SATURATED, 1, 7.0, 8.0, HOLDS, HOLDING), entered(HOLDING)
    expect(s, before, *held_on, event(2, SATURATED, 1, 7.0, 8.0, RAMPS, HOLDING), ramping)
    assert (s["fault"], s["fault_axis"], s["trips"]) == (FOLLOWING_ERROR, 0, 1)


def test_the_fault_that_ends_the_run_is_a_trip_of_its_own():
    p, s = cell()
    p["reaction"][HOST_DEAD] = RAMPS
    raise_fault(p, s, FOLLOWING_ERROR, 2, 6.0, 5.0, HOLDS)
    before = s.copy()
    cell_fault(p, s, HOST_DEAD, True, 120.0, 100.0)
    former = put(former=FOLLOWING_ERROR, former_axis=2, former_value=6.0, former_limit=5.0)
    expect(
        s,
        before,
        raised(HOST_DEAD),
        event(1, HOST_DEAD, -1, 120.0, 100.0, RAMPS, HOLDING),
        former,
        latch(HOST_DEAD, -1, 120.0, 100.0),
        ramping,
    )
    assert s["trips"] == 2


def test_without_a_fault_before_it_nothing_is_kept_beside_it():
    p, s = cell(trips=3, fault_axis=1, fault_cycle=900, fault_value=1.0, fault_limit=2.0, former=SATURATED)
    p["reaction"][HOST_DEAD] = RAMPS
    before = s.copy()
    cell_fault(p, s, HOST_DEAD, True, 120.0, 100.0)
    event_of_it = event(0, HOST_DEAD, -1, 120.0, 100.0, RAMPS)
    expect(s, before, raised(HOST_DEAD), event_of_it, latch(HOST_DEAD, -1, 120.0, 100.0), ramping)


def test_after_a_reset_the_next_fault_is_latched():
    p, s = cell(trips=3, fault_cycle=900, fault_value=1.0, fault_limit=2.0)
    before = s.copy()
    raise_fault(p, s, SATURATED, 1, 7.0, 8.0, RAMPS)
    expect(s, before, event(0, SATURATED, 1, 7.0, 8.0, RAMPS), latch(SATURATED, 1, 7.0, 8.0), ramping)
    assert s["trips"] == 4


STATES = (OFF, READY, ARMING, TRACKING, HOLDING, RAMPING, FAULT)
STAYS = ()
AFTER = {
    # state: (HOLDS, RAMPS, CUTS)
    OFF: ((entered(FAULT),), (entered(FAULT),), ()),
    READY: ((entered(FAULT),), (entered(FAULT),), (dropped,)),
    ARMING: ((ramping,), (ramping,), (dropped,)),
    TRACKING: ((held,), (ramping,), (dropped,)),
    HOLDING: (STAYS, (ramping,), (dropped,)),
    RAMPING: (STAYS, STAYS, (dropped,)),
    FAULT: (STAYS, STAYS, (dropped,)),
}


@pytest.mark.parametrize("reaction", [HOLDS, RAMPS, CUTS])
@pytest.mark.parametrize("state", STATES)
def test_reactions(state, reaction):
    p, s = cell(state, phase=LIFTING)
    before = s.copy()
    react(p, s, reaction)
    expect(s, before, *AFTER[state][(HOLDS, RAMPS, CUTS).index(reaction)])


def test_armed_with_the_outer_loop_closed_it_can_be_held():
    p, s = cell(ARMING, phase=CLOSED)
    before = s.copy()
    react(p, s, HOLDS)
    expect(s, before, held)


@pytest.mark.parametrize("phase", [LIFTING, PARKING])
def test_armed_with_the_outer_loop_open_there_is_nothing_to_hold(phase):
    p, s = cell(ARMING, phase=phase)
    before = s.copy()
    react(p, s, HOLDS)
    expect(s, before, ramping)


def test_a_soft_stop_is_cut_short():
    for reaction in (HOLDS, RAMPS):
        p, s = cell(RAMPING, soft=1, phase=CLOSED)
        before = s.copy()
        react(p, s, reaction)
        expect(s, before, ramping)


def test_a_hold_that_was_asked_for_is_limited_from_its_first_fault_on():
    p, s = cell(HOLDING, fault=DISAGREEMENT, fault_cycle=1000)
    before = s.copy()
    react(p, s, HOLDS)
    expect(s, before, entered(HOLDING))
    p, s = cell(HOLDING, fault=DISAGREEMENT, fault_cycle=950)
    before = s.copy()
    react(p, s, HOLDS)
    expect(s, before)


def test_unlatching_lets_every_condition_be_raised_anew():
    p, s = cell(FAULT, fault=DISAGREEMENT, raised=5, overrun_level=7.5, overruns_in_a_row=3)
    s["watch"]["raised"], s["watch"]["frozen"] = 9, 1
    before = s.copy()
    forget(p, s)
    before["watch"]["raised"], before["watch"]["frozen"] = 0, 0
    expect(s, before, put(fault=NO_FAULT, raised=0, overrun_level=0.0, overruns_in_a_row=0))
    two, s = cell(FAULT)
    two["axes"] = 2
    s["watch"]["frozen"] = 1
    forget(two, s)
    assert s["watch"]["frozen"].tolist() == [0, 0, 1]
