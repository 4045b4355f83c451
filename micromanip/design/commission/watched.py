"""Experiments of commissioning: a fault ends them with a sentence."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.faults import KINDS
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import FeedbackPath

from ..experiment import Experiment

Array = NDArray[np.float64]


class Watched:
    """An experiment that raises CheckFailed where a fault ended it."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment

    def __call__(
        self, configuration: Configuration, seconds: float, samples: Array | None = None, every: int = 1
    ) -> NDArray[np.void]:
        """The rows of the experiment."""
        rows = self._experiment(configuration, seconds, samples, every)
        faults = rows["fault"][rows["fault"] != 0]
        if len(faults):
            kind = KINDS[int(faults[0])]
            causes = "; or ".join(kind.likely_causes)
            raise CheckFailed(
                f"the experiment was ended by fault {kind.code}; nothing was tuned. Likely: {causes}. {kind.next_step}"
            )
        return rows

    def path(self, configuration: Configuration, axis: str) -> FeedbackPath:
        """What the sensors and the output of `axis` take."""
        return self._experiment.path(configuration, axis)
