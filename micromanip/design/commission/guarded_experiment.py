"""Experiments of commissioning: a fault ends them with a sentence, and a host that stood still is told as that.

What is left of a commissioning that was stopped: what had been found, where and why it stopped, what to do next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import Array
from micromanip.errors import CheckFailed, sentence
from micromanip.faults import KINDS
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import FeedbackPath

from ..experiment import Ended, Experiment
from ..report.model import Criterion, Evidence, Section

Say = Callable[[str], None]
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


class Stopped(CheckFailed):
    """A step said no; `evidence` is what the axis is left with."""

    def __init__(self, problem: str, evidence: Evidence) -> None:
        """`problem` is told as it is."""
        super().__init__(problem)
        self.evidence = evidence


@dataclass
class Steps:
    """The steps of one axis as they are done; `say` is told of each."""

    axis: str
    say: Say
    now: str = "beginning"
    done: list[str] = field(default_factory=list)
    figures: dict[str, str] = field(default_factory=dict)

    def begin(self, step: str) -> None:
        """What comes next; the step before has succeeded."""
        if self.now != "beginning":
            self.done.append(self.now)
        self.now = step
        self.say(step)

    def learn(self, **figures: str) -> None:
        """Figures that stay, whatever comes later."""
        self.figures.update({name.replace("_", " "): value for name, value in figures.items()})

    @contextmanager
    def kept(self, stalled: Callable[[], str]) -> Iterator[None]:
        """Raises Stopped, with all that was found, where CheckFailed or a signal that can't be used ends a step.

        What `stalled` says of the experiment before is added: then no sensor is to blame.
        """
        try:
            yield
        except (CheckFailed, ValueError) as problem:
            told = stalled()
            text = f"{sentence(problem)} {told}" if told else str(problem)
            raise Stopped(self._said(text), self._evidence(text)) from problem

    def _said(self, text: str) -> str:
        return text if text.startswith(f"axis {self.axis}") else f"axis {self.axis}: {self.now}: {text}"

    def _evidence(self, problem: str) -> Evidence:
        criteria = [Criterion(self.axis, step, True, "done", "to succeed") for step in self.done]
        criteria.append(Criterion(self.axis, self.now, False, problem, "to succeed"))
        text = (
            f"Commissioning stopped at the step '{self.now}': {sentence(problem)} The steps before it have succeeded; "
            "what they found is below. Correct the cause, and commission the axis again: nothing was applied."
        )
        return Evidence(self.axis, tuple(criteria), (Section("Stopped", text, dict(self.figures)),))
