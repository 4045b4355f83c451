"""Experiments of commissioning: a fault ends them with a sentence, and a host that stood still is told as that."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.faults import KINDS
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import FeedbackPath

from ..experiment import Ended, Experiment

Array = NDArray[np.float64]
_STALL, _STALL_S = 5.0, 0.005
"""So many of the usual times between samples, and at least so long, without one from any sensor is a stall."""


class GuardedExperiment:
    """An experiment that raises CheckFailed where a fault ended it."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment, self._silent_s, self._longest_s = experiment, 0.0, 0.0

    @property
    def stalled(self) -> str:
        """Of the last experiment, in a sentence: for how long all sensors were silent at once; empty if never."""
        return _told(self._silent_s)

    @property
    def ever_stalled(self) -> str:
        """The same of all of them."""
        return _told(self._longest_s)

    def __call__(
        self, configuration: Configuration, seconds: float, samples: Array | None = None, every: int = 1
    ) -> NDArray[np.void]:
        """The rows of the experiment."""
        self._silent_s = 0.0
        try:
            rows = self._experiment(configuration, seconds, samples, every)
        except Ended as ended:
            self._judge(ended.rows, configuration)
            raise
        if every == 1:
            self._judge(rows, configuration)
        faults = rows["fault"][rows["fault"] != 0]
        if len(faults):
            kind = KINDS[int(faults[0])]
            causes = "; or ".join(kind.likely_causes)
            raise CheckFailed(
                f"the experiment was ended by fault {kind.code}; nothing was tuned. Likely: {causes}. {kind.next_step}"
            )
        return rows

    def _judge(self, rows: NDArray[np.void], configuration: Configuration) -> None:
        self._silent_s = _stall_s(rows, len(configuration.axes), configuration.loop.period_ns * 1e-9)
        self._longest_s = max(self._longest_s, self._silent_s)

    def path(self, configuration: Configuration, axis: str) -> FeedbackPath:
        """What the sensors and the output of `axis` take."""
        return self._experiment.path(configuration, axis)


def _told(silent_s: float) -> str:
    if not silent_s:
        return ""
    return (
        "But this computer or the device stood still meanwhile: no sensor said anything for "
        f"{1e3 * silent_s:.0f} ms. Try again on a quieter machine before you look for a cause elsewhere"
    )


def _stall_s(rows: NDArray[np.void], axes: int, period_s: float) -> float:
    """The longest time without a sample of any sensor, where that is no pause as usual; else 0."""
    heard = rows["cycle"][(rows["axis"]["fresh"][:, :axes] != 0).any(axis=1)]
    if len(heard):  # a silence that lasts ends with the rows
        heard = np.append(heard, rows["cycle"][-1])
    pauses = np.diff(np.unique(heard)) * period_s  # of a cycle that was missed there is the row before once more
    if not len(pauses):
        return 0.0
    longest_s = float(pauses.max())
    return longest_s if longest_s > max(_STALL_S, _STALL * float(np.median(pauses))) else 0.0
