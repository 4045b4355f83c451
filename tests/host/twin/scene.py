"""A recorded stretch of tracking of the simulated cell, for a test to spoil and to replay."""

from dataclasses import replace

import numpy as np

from micromanip.settings.compile.limits import NEVER

TRACKING_CYCLES = 2000


class Scene:
    """Copies of what was recorded, and of the parameters; nothing is a fault, for the twin only tracks."""

    def __init__(self, recording):
        self._recording = recording
        self.signals, self.periods = recording.signals.copy(), recording.periods.copy()
        self.parameters = recording.parameters.copy()
        self.p, self.cycles = self.parameters[0], len(recording.signals)
        self.p["score_cycles"] = 50
        self.axes = self.p["axis"]
        watch = self.axes["watch"]
        for name in watch.dtype.names:
            if name.endswith(("_samples", "_identical", "stale_cycles", "lost_cycles", "saturating_cycles", "swings")):
                watch[name] = NEVER
        for name in ("innovation_ratio", "following_um", "band_um"):
            watch[name] = np.inf

    def forget_ages(self):
        """Samples may be of any age: with skipped periods they fall behind for good."""
        for age in ("strain_age_ns", "stage_age_ns", "reference_age_ns"):
            self.axes[age] = NEVER

    def sensor(self, role, axis=0):
        """The recorded samples of one sensor, (cycles,), to write into."""
        return self.signals[:, int(self.axes[axis][role])]

    def recording(self):
        """What to replay."""
        return replace(self._recording, parameters=self.parameters, signals=self.signals, periods=self.periods)
