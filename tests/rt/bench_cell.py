"""A cell of three axes around a small plant in plain Python, stepped cycle by cycle in all three modes.

Axis x is in mode stage and follows the tracker, y in mode strain and plays sines, z is a voltage that plays
sines: every branch of the cycle at once. The plant is good enough to be controlled, no more.
"""

import copy
import functools
import math

import numpy as np

from campaigns.report import CONFIG
from micromanip.rt.cell import cell_cycle
from micromanip.rt.laws.reference import SINES
from micromanip.rt.records import CELL_STATE, MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.rt.states import ARM, NO_COMMAND, READY, TRACKING, VOLTAGE
from micromanip.rt.transitions import begin_cycle
from micromanip.settings.check import prepare
from micromanip.settings.compile.limits import NEVER

X, Y, Z = range(3)
STRAIN = 1

_SUBSTEPS = 2
_OMEGA, _DAMPING, _GAIN = 2 * math.pi * 66.0, 0.05, 5.0


@functools.cache
def prepared():
    return prepare(CONFIG / "paper.yaml")


def parameters(lift=40, settle=10, authority=40, ramp=60):
    """The tuned cell with short ramps, its axes in three different modes."""
    record = prepared().parameters.copy()
    p = record[0]
    p["lift_cycles"], p["settle_cycles"], p["authority_cycles"], p["ramp_cycles"] = lift, settle, authority, ramp
    p["score_cycles"] = 20
    p["check_cycles"] = p["sweep_cycles"] = 0
    p["hold_cycles"] = 50
    for axis in p["axis"]:
        axis["path_error"] = axis["uncompensated"] = -1
        axis["strain_range_um"], axis["stage_range_um"] = (-1000.0, 1000.0), (-1000.0, 1000.0)
        axis["authority_step"] = 1.0 / authority
        axis["watch"]["decay_cycles"] = 40
        forgive(axis)
    for i, offset in ((Y, 60.0), (Z, 50.0)):
        r = p["axis"][i]["reference"]
        r["kind"], r["offset_um"], r["sines"] = SINES, offset, 1
        r["amplitude_um"][0], r["omega"][0] = 20.0, 2 * math.pi * 5.0
    p["axis"][Y]["mode"] = STRAIN
    z = p["axis"][Z]
    z["mode"], z["setpoint_low_um"], z["setpoint_high_um"], z["setpoint_slew_um"] = VOLTAGE, -20.0, 150.0, 4.0
    return record


def forgive(axis):
    """No limits but those of unusable samples: the plant has no noise, and its model is a rough one."""
    w = axis["watch"]
    w["strain_identical"] = w["stage_identical"] = NEVER
    w["coast_cycles"], w["degraded_cycles"] = 5, 10
    axis["strain_rate_um_per_ns"] = axis["stage_rate_um_per_ns"] = math.inf
    w["innovation_ratio"] = w["following_um"] = w["band_um"] = math.inf
    w["saturating_cycles"] = w["saturated_cycles"] = NEVER
    w["stale_cycles"], w["lost_cycles"] = 200, 5000


def wire_lines(p):
    """Give every digital input a place in the image: ``{(name, axis): place}``."""
    keys = [(name, None) for name in ("enable", "interlock", "retracted")]
    keys += [(name, i) for name in ("amplifier_ok", "temperature_ok") for i in range(3)]
    places = {key: MAX_SIGNALS - 1 - k for k, key in enumerate(keys)}
    for (name, i), place in places.items():
        line = p[name] if i is None else p["axis"][i][name]
        line["signal"], line["age_ns"] = place, NEVER
    return places


def tracking():
    """A cell that tracks, with the parameters above."""
    return _tracking().copy()


@functools.cache
def _tracking():
    return BenchCell().arm()


class BenchCell:
    """Plant, process image and loop state; `step` is one cycle."""

    def __init__(self, record=None, *, lines=False):
        """`lines` wires all digital inputs; they are good, and not retracted, but for what `lines` then holds."""
        self.parameters = parameters() if record is None else record
        self.lines = {}
        self._wired = wire_lines(self.parameters[0]) if lines else {}
        self.state = np.zeros(1, CELL_STATE)
        self.signals = np.zeros(MAX_SIGNALS, SIGNAL)
        self.outputs = np.zeros(MAX_OUTPUTS)
        self.samples = np.zeros((1, 3))
        self.now_ns = 1_000_000_000
        self.spoiled = {}
        """Sensors (role, axis) that give the value and status here; None: that say nothing."""
        self.p, self.s = self.parameters[0], self.state[0]
        self.s["state"] = READY
        for i in range(3):
            self.s["axis"][i]["voltage_V"] = self.p["axis"][i]["limiter"]["park_V"]
        self.strain, self.stage, self.speed = [0.0] * 3, [-5.0 * 66.0] * 3, [0.0] * 3

    @property
    def voltages(self):
        return [float(self.outputs[self.p["axis"][i]["voltage"]]) for i in range(3)]

    def _move(self, periods):
        h = 1e-4 / _SUBSTEPS
        for i, v in enumerate(self.voltages):
            x, dx, y = self.stage[i], self.speed[i], self.strain[i]
            for _ in range(periods * _SUBSTEPS):
                y += (0.9 * v - y) * 0.3
                dx += h * (_OMEGA**2 * (_GAIN * (y - 66.0) - x) - 2 * _DAMPING * _OMEGA * dx)
                x += h * dx
            self.stage[i], self.speed[i], self.strain[i] = x, dx, y

    def _put(self, role, i, value):
        value, status = self.spoiled.get((role, i), (value, 0)) or (None, 0)
        if value is None:
            return
        signal = self.signals[self.p["axis"][i][role]]
        signal["value"], signal["status"], signal["time_ns"] = value, status, self.now_ns
        signal["sequence"] += 1

    def step(self, command=NO_COMMAND, periods=1):
        """One cycle; whether `command` was accepted."""
        self.now_ns += periods * 100_000
        self._move(periods)
        for i in range(3):
            self._put("strain", i, self.strain[i])
            self._put("stage", i, self.stage[i])
            if self.s["cycle"] % 10 == 0:  # the tracker
                self._put("deviation", i, 50.0 * math.sin(2 * math.pi * 3.0 * self.now_ns * 1e-9))
        for key, place in self._wired.items():
            signal = self.signals[place]
            signal["value"] = self.lines.get(key, 0.0 if key[0] == "retracted" else 1.0)
            signal["time_ns"] = self.now_ns
            signal["sequence"] += 1
        self.begin_cycle(periods - 1)
        return bool(cell_cycle(self.p, self.s, self.signals, self.outputs, self.samples, command, self.now_ns))

    def begin_cycle(self, missed):
        """What comes before the axes' cycle; where the loop's supervision is looked at, it is that."""
        begin_cycle(self.s, missed)

    def run(self, cycles):
        """Voltages (cycles, 3) of so many cycles."""
        course = np.zeros((cycles, 3))
        for k in range(cycles):
            self.step()
            course[k] = self.voltages
        return course

    def copy(self):
        """Another cell that goes on from here."""
        other = copy.copy(self)
        for name in ("parameters", "state", "signals", "outputs", "spoiled", "lines", "strain", "stage", "speed"):
            setattr(other, name, getattr(self, name).copy())
        other.p, other.s = other.parameters[0], other.state[0]
        return other

    def arm(self):
        """Until every axis tracks."""
        self.run(5)
        assert self.step(ARM)
        self.run(int(self.p["lift_cycles"] + self.p["settle_cycles"] + self.p["authority_cycles"]))
        assert self.s["state"] == TRACKING
        return self
