"""Anything in any order: commands, sensor faults, lines, overruns, swaps; what must hold in every single cycle.

``make thorough`` takes 1,600 steps, the campaign ``machine`` ten thousand.
"""

import math

import numba
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from micromanip.rt.faults import cell_fault
from micromanip.rt.shadow import swap_cell
from micromanip.rt.states import (
    ARM,
    ARMING,
    DISARM,
    DRIVER_ERROR,
    FAULT,
    FOLLOWING_ERROR,
    HOLD,
    HOLDING,
    NO_COMMAND,
    NO_FAULT,
    OFF,
    RAMPING,
    READY,
    RESET,
    STOP,
    TRACKING,
)

from .bench_cell import BenchCell, parameters

SENSORS = [(role, axis) for role in ("strain", "stage", "deviation") for axis in range(3)]
LINES = ("enable", "interlock", "retracted", "amplifier_ok", "temperature_ok")
MOVING = (ARMING, TRACKING, HOLDING, RAMPING)
ARMED_STATES = (ARMING, TRACKING)
"""Only a command leads here from where nothing is tracked."""
PARKS = (3.0, 0.0, -8.0)

ALLOWED = {
    OFF: {},
    READY: {ARM: ARMING, STOP: OFF},
    ARMING: {DISARM: RAMPING, STOP: RAMPING, HOLD: HOLDING, NO_COMMAND: TRACKING},
    TRACKING: {DISARM: RAMPING, STOP: RAMPING, HOLD: HOLDING},
    HOLDING: {ARM: ARMING, DISARM: RAMPING, STOP: RAMPING},
    RAMPING: {},
    FAULT: {RESET: READY, STOP: OFF},
}
"""Changes of state by command, or (NO_COMMAND) by time; faults and the end of a ramp come on top."""


class CellMachine(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.switch_on()

    def switch_on(self):
        record = parameters(lift=15, settle=3, authority=12, ramp=25)
        record[0]["hold_cycles"], record[0]["sweep_cycles"] = 30, 10
        for i, park in enumerate(PARKS):
            axis = record[0]["axis"][i]
            axis["limiter"]["park_V"] = park
            axis["watch"]["following_um"], axis["watch"]["following_cycles"] = 60.0, 20
            axis["watch"]["saturating_cycles"], axis["watch"]["saturated_cycles"] = 5, 30
            axis["watch"]["band_um"], axis["watch"]["lost_cycles"] = 5.0, 100
        self.cell = BenchCell(record, lines=True)
        self.slew = float(record[0]["axis"][0]["limiter"]["slew_V"])
        self.resting = 0

    def cycle(self, command=NO_COMMAND, periods=1):
        cell, s = self.cell, self.cell.s
        state, fault, before = int(s["state"]), int(s["fault"]), [float(s["axis"][i]["voltage_V"]) for i in range(3)]
        accepted = cell.step(command, periods)
        self.check_outputs(before)
        self.check_state(state, fault, command, accepted)
        self.check_rest(state)
        return accepted

    def check_outputs(self, before):
        for previous, v in zip(before, self.cell.voltages, strict=True):
            assert math.isfinite(v)
            assert -20.0 <= v <= 150.0
            assert abs(v - previous) <= self.slew + 1e-12

    def check_state(self, state, fault, command, accepted):
        s = self.cell.s
        now = int(s["state"])
        if now in ARMED_STATES and state not in (*ARMED_STATES, now):  # nothing re-arms by itself
            assert accepted
            assert command == ARM
        if now != state:
            by_command = accepted and ALLOWED[state].get(command) == now
            by_time = ALLOWED[state].get(NO_COMMAND) == now or (state == RAMPING and now in (READY, OFF, FAULT))
            graver = {ARMING: (HOLDING, RAMPING, FAULT), TRACKING: (HOLDING, RAMPING, FAULT), HOLDING: (RAMPING, FAULT)}
            by_fault = s["fault"] != NO_FAULT and now in graver.get(state, (FAULT,))
            # one cycle may both carry out a command and finish a phase, and a stop goes on to OFF
            both = now == OFF and s["stopping"]
            assert by_command or by_time or by_fault or both, (state, now, command)
        if fault != NO_FAULT:  # latched until reset, and only a FAULT can be reset
            assert s["fault"] == fault or (command == RESET and accepted and state == FAULT)
        if now == FAULT:
            assert s["fault"] != NO_FAULT
        if now in (ARMING, TRACKING, READY):
            assert s["fault"] == NO_FAULT

    def check_rest(self, state):
        """At rest the outputs go to park at the slew limit at the latest, and stay there."""
        self.resting = self.resting + 1 if state == self.cell.s["state"] and state not in MOVING else 0
        if self.resting > 170.0 / self.slew + 1:
            assert self.cell.voltages == list(PARKS)

    @rule(command=st.sampled_from([ARM, ARM, ARM, DISARM, STOP, RESET, RESET, HOLD, HOLD]))
    def command(self, command):
        self.cycle(command)

    @rule(cycles=st.integers(1, 50))
    def wait(self, cycles):
        for _ in range(cycles):
            self.cycle()

    @rule(periods=st.lists(st.sampled_from([1, 1, 2, 3, 17, 400]), min_size=1, max_size=12))
    def overruns(self, periods):
        for n in periods:
            self.cycle(periods=n)

    @rule(
        sensor=st.sampled_from(SENSORS),
        value=st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([math.nan, 1e308, 0.0])),
        status=st.sampled_from([0, 0, 0, 1]),
        cycles=st.integers(1, 6),
    )
    def spoil(self, sensor, value, status, cycles):
        self.cell.spoiled[sensor] = (value, status)
        self.wait(cycles)
        del self.cell.spoiled[sensor]

    @rule(sensor=st.sampled_from(SENSORS), cycles=st.integers(1, 12))
    def silence(self, sensor, cycles):
        self.cell.spoiled[sensor] = None
        self.wait(cycles)
        del self.cell.spoiled[sensor]

    @rule(code=st.integers(1, 100))
    def driver_error(self, code):
        cell_fault(self.cell.p, self.cell.s, DRIVER_ERROR, True, float(code), 0.0)
        self.cycle()
        cell_fault(self.cell.p, self.cell.s, DRIVER_ERROR, False, 0.0, 0.0)

    @rule(line=st.sampled_from(LINES), axis=st.integers(0, 2), cycles=st.integers(1, 40))
    def line(self, line, axis, cycles):
        """A digital input changes for a while: good ones go away, the tool is retracted."""
        self.cell.lines[line, axis if line.endswith("_ok") else None] = 1.0 if line == "retracted" else 0.0
        self.wait(cycles)
        self.cell.lines.clear()

    @rule(gain=st.floats(0.2, 1.5), reaction=st.integers(0, 3), effort=st.booleans())
    def swap(self, gain, reaction, effort):
        """Another set of parameters, at a cycle boundary."""
        new = self.cell.parameters.copy()
        for axis in new[0]["axis"]:
            axis["pid"]["K_V_per_um"] = gain
            axis["watch"]["reaction"][FOLLOWING_ERROR] = reaction
            axis["outer"]["feedback"] *= 1.01 if effort else 1.0
        swap_cell(self.cell.p, new[0], self.cell.s)
        self.cell.parameters, self.cell.p = new, new[0]
        self.wait(3)

    @precondition(lambda self: self.cell.s["state"] == TRACKING)
    @rule(axis=st.integers(0, 2), name=st.sampled_from(["strain", "stage"]))
    def lost_reference_state(self, axis, name):
        """Something inside turns NaN."""
        self.cell.s["axis"][axis]["estimator"]["x"][2] = math.nan
        self.cell.s["axis"][axis]["reference"]["filtered"][0] = math.nan
        self.wait(3)

    @precondition(lambda self: self.cell.s["state"] == READY)
    @rule()
    def whole_arming(self):
        self.wait(6)
        if self.cycle(ARM):
            self.wait(50)
            assert self.cell.s["state"] == TRACKING or self.cell.s["fault"] != NO_FAULT

    @precondition(lambda self: self.cell.s["state"] == FAULT)
    @rule()
    def recover(self):
        stopping = bool(self.cell.s["stopping"])  # who has said stop is not brought back by a reset
        assert self.cycle(RESET) != stopping
        assert self.cell.s["state"] == (FAULT if stopping else READY) or self.cell.s["state"] == OFF

    @precondition(lambda self: self.cell.s["state"] == OFF)
    @rule()
    def switch_on_again(self):
        """As a new loop process does."""
        self.switch_on()


TestCellMachine = CellMachine.TestCase
if (profile := settings.get_current_profile_name()) != "soak":
    courses = 5 if numba.config.DISABLE_JIT else 40 if profile == "thorough" else 15
    TestCellMachine.settings = settings(
        max_examples=courses, stateful_step_count=15 if numba.config.DISABLE_JIT else 40
    )
