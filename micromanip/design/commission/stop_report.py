"""What is left of a commissioning that was stopped: what had been found, where and why it stopped, what to do next."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from micromanip.errors import CheckFailed, sentence

from ..report.model import Criterion, Evidence, Section

if TYPE_CHECKING:
    from collections.abc import Iterator

Say = Callable[[str], None]


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
