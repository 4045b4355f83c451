"""Every cycle's outputs of a running controller, watched from outside while its processes die."""

import threading

import numpy as np

from micromanip.host.ring import RingReader
from micromanip.rt.phases import PHASE_NAMES
from micromanip.rt.states import STATE_NAMES

_PAUSE_S = 0.02
_ROUNDING = 1 + 1e-9


class Envelope:
    """Follows the telemetry ring of `cell` in a thread; its memory outlives whoever wrote it.

    Ranges and slew limits are those in force when the watch begins; the campaign changes none of them.
    """

    def __init__(self, cell):
        parameters = cell.control["parameters"][0]
        self.axes = int(parameters["axes"])
        limiter = parameters["axis"]["limiter"][: self.axes]
        self._low_V, self._high_V, self._slew_V = (limiter[name].copy() for name in ("low_V", "high_V", "slew_V"))
        self.park_V = limiter["park_V"].copy()
        self.slew_V_per_s = self._slew_V / (parameters["period_ns"] * 1e-9)
        self._reader = RingReader(cell.ring)
        self._reader.position = 0
        self.cycles, self.largest_step_V = 0, 0.0
        self.voltage_V = self.park_V.copy()
        """Of the newest cycle, by axis."""
        self.highest_V, self.lowest_V = self.park_V.max(), self.park_V.min()
        self.course = []
        """``(time_ns, state, fault, phase)`` of each cycle in which one of the last three changed."""
        self.last_ns = 0
        self._violations = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._follow)
        self._thread.start()

    def end(self):
        """Watch what is left in the ring, and stop."""
        self._ending.set()
        self._thread.join()

    def forget(self):
        """Let go of the memory; the watch is over."""
        del self._reader

    def fresh_violations(self):
        """What was not as it must be, since the last call."""
        found, self._violations = self._violations, []
        lost, self._reader.lost = self._reader.lost, 0
        return [*found, f"{lost} cycles passed unseen"] if lost else found

    def fresh_step(self):
        """The largest step of one cycle since the last call (V)."""
        step, self.largest_step_V = self.largest_step_V, 0.0
        return step

    def names_since(self, time_ns):
        """Names of the states that were entered after `time_ns` (CLOCK_MONOTONIC), and of the one before."""
        states = [STATE_NAMES[state] for at, state, _, _ in self.course if at > time_ns]
        names = [self.at(time_ns)[0], *states]
        return [name for k, name in enumerate(names) if k == 0 or name != names[k - 1]]

    def at(self, time_ns):
        """State and phase at `time_ns`, by their names."""
        before = [(state, phase) for at, state, _, phase in self.course if at <= time_ns] or [(0, 0)]
        return STATE_NAMES[before[-1][0]], PHASE_NAMES[before[-1][1]]

    def _follow(self):
        while not self._ending.wait(_PAUSE_S):  # one batch holds many times what comes in a pause
            if len(rows := self._reader.read()):
                self._check(rows)
        while len(rows := self._reader.read()):
            self._check(rows)

    def _check(self, rows):
        voltage = np.concatenate([self.voltage_V[None], rows["axis"]["voltage_V"][:, : self.axes]])
        steps = np.abs(np.diff(voltage, axis=0))
        for wrong, what in (
            (~np.isfinite(voltage[1:]), "not finite"),
            ((voltage[1:] < self._low_V) | (voltage[1:] > self._high_V), "outside the range"),
            (~(steps <= self._slew_V * _ROUNDING), "faster than the slew limit"),
        ):
            if wrong.any():
                k = int(np.flatnonzero(wrong.any(axis=1))[0])
                self._violations.append(f"cycle {rows['cycle'][k]}: {voltage[k]} V to {voltage[k + 1]} V, {what}")
        self.cycles += len(rows)
        self.largest_step_V = max(self.largest_step_V, float(steps.max()))
        self.highest_V, self.lowest_V = max(self.highest_V, voltage.max()), min(self.lowest_V, voltage.min())
        self.voltage_V = voltage[-1]
        now = np.stack([rows[name] for name in ("state", "fault", "phase")], axis=1)
        last = np.array(self.course[-1][1:] if self.course else (-1, -1, -1))
        changed = np.flatnonzero((np.diff(np.concatenate([last[None], now]), axis=0) != 0).any(axis=1))
        self.course += [(int(rows["time_ns"][k]), *map(int, now[k])) for k in changed]
        self.last_ns = int(rows["time_ns"][-1])
