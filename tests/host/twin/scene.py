"""A recorded stretch of the simulated cell with short times, for a test to spoil and to replay."""

from dataclasses import replace

import numpy as np

from micromanip.rt.records import EVENTS, MAX_OUTPUTS, MAX_SIGNALS
from micromanip.rt.states import WARN
from micromanip.settings.compile.limits import NEVER

TRACKING_CYCLES = 2000
SHORT = {
    "check_cycles": 20,
    "lift_cycles": 60,
    "sweep_cycles": 100,
    "settle_cycles": 20,
    "authority_cycles": 100,
    "ramp_cycles": 150,
    "hold_cycles": 200,
    "score_cycles": 50,
}
SENSITIVE = {
    "decay_cycles": 80,
    "coast_cycles": 20,
    "degraded_cycles": 40,
    "stale_cycles": 30,
    "lost_cycles": 100,
    "hot_cycles": 120,
}
SWITCHES = ("amplifier_enable", "feed_hold", "heartbeat")


class Scene:
    """Copies of what was recorded, and of the parameters; every fault only warns until `reacts` says more."""

    def __init__(self, recording):
        self._recording = recording
        self.signals, self.commands = recording.signals.copy(), recording.commands.copy()
        self.periods = recording.periods.copy()
        self.parameters = recording.parameters.copy()
        self.p, self.cycles = self.parameters[0], len(recording.signals)
        for name, value in SHORT.items():
            self.p[name] = value
        self.axes = self.p["axis"]
        self.axes["authority_step"] = 1.0 / SHORT["authority_cycles"]
        self.limits = self.axes["watch"]
        for name, value in SENSITIVE.items():
            self.limits[name] = value
        self.limits["reaction"] = self.p["reaction"] = WARN
        self._free = MAX_SIGNALS

    def reacts(self, code, reaction):
        """What follows a fault."""
        self.limits["reaction"][:, code] = self.p["reaction"][code] = reaction

    def forget_ages(self):
        """Samples may be of any age: with skipped periods they fall behind for good."""
        for age in ("strain_age_ns", "stage_age_ns", "reference_age_ns"):
            self.axes[age] = NEVER

    def sensor(self, role, axis=0):
        """The recorded samples of one sensor, (cycles,), to write into."""
        return self.signals[:, int(self.axes[axis][role])]

    def wire(self, name, axis=None):
        """Give a digital input a place in the image; its course (cycles,), 1 so far, to write into."""
        self._free -= 1
        line = self.p[name] if axis is None else self.axes[axis][name]
        line["signal"], line["age_ns"] = self._free, NEVER
        signal = self.signals[:, self._free]
        signal["sequence"] = np.arange(1, self.cycles + 1)
        signal["time_ns"] = self.sensor("strain")["time_ns"]
        signal["value"] = 1.0
        return signal["value"]

    def wire_switches(self):
        """Give the digital outputs a place in the image."""
        for k, name in enumerate(SWITCHES):
            self.p[name] = MAX_OUTPUTS - 1 - k
        self.p["heartbeat_cycles"] = 7

    def recording(self):
        """What to replay."""
        spoiled = {"signals": self.signals, "commands": self.commands, "periods": self.periods}
        return replace(self._recording, parameters=self.parameters, **spoiled)


def course(rows):
    """States in the order in which they were entered."""
    states = rows["state"]
    return [int(states[0]), *(int(state) for state in states[1:][np.diff(states) != 0])]


def codes(outcome):
    """Codes of all events of axis x and of the cell, in order."""
    state = outcome.state[0]
    assert state["events"] <= EVENTS
    return [int(event["code"]) for event in state["event"][: state["events"]] if event["axis"] <= 0]
