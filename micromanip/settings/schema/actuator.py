"""Linear dynamics of an actuator as they stand in the configuration: what its feedforward undoes in mode strain."""

from __future__ import annotations

from pydantic import Field

from micromanip.quantities import Hertz, Microseconds, MicrosecondsOrZero, Percent, Positive
from micromanip.rt.laws.resonance import MAX_RESONANCES

from .base import Settings


class Resonance(Settings):
    """A resonance of stage and flexure as the gauge shows it, and the antiresonance beside it."""

    resonance_Hz: Hertz
    resonance_damping: Positive = Field(description="Its damping ratio.")
    antiresonance_Hz: Hertz = Field(description="Both below 0.45 times the loop's rate.")
    antiresonance_damping: Positive = Field(description="Its damping ratio: that of the filter's own swing.")


class Actuator(Settings):
    """Between voltage and gauge, beside the hysteresis: undone in mode strain, or awaited where it can't be undone.

    In mode stage it is the outer loop's model that has all of it.
    """

    delay_us: MicrosecondsOrZero = Field(
        default=0.0,
        description="From a set-point to the position that answers it, beyond what a bus takes. A reference that is "
        "known (hold, sine, step, file) is followed so much ahead, and the PID awaits the answer.",
    )
    gauge_us: MicrosecondsOrZero = Field(
        default=0.0,
        description="From the position to what the gauge reads of it, by its data sheet: 1e6/(2 pi bandwidth). The "
        "PID awaits it too, or it would make the position lead by it.",
    )
    lag_us: Microseconds | None = Field(
        default=None,
        description="First-order lag of the amplifier, undone by leading the inverse's voltage; not in delay_us. "
        "null: none.",
    )
    feedback_percent: Percent = Field(
        default=100.0,
        description="Share of the PID's gains that is left to do: what the feedforward does need not be done again, "
        "and less feedback passes on less of the gauge's noise.",
    )
    resonances: tuple[Resonance, ...] = Field(
        default=(), max_length=MAX_RESONANCES, description="Undone before the inverse."
    )
