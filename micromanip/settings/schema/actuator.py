"""Linear dynamics of an actuator as they stand in the configuration: what its feedforward undoes in mode strain."""

from __future__ import annotations

from pydantic import Field

from micromanip.quantities import Hertz, Microseconds, MicrosecondsOrZero, Percent, Positive
from micromanip.rt.laws.resonance import MAX_RESONANCES

from .base import Settings


class Resonance(Settings):
    """A resonance of stage and flexure as the gauge measures it, with its antiresonance."""

    resonance_Hz: Hertz
    resonance_damping: Positive = Field(description="Damping ratio.")
    antiresonance_Hz: Hertz = Field(description="Both frequencies must be below 0.45 times the loop's rate.")
    antiresonance_damping: Positive = Field(description="Damping ratio; also that of the filter.")


class Actuator(Settings):
    """Between voltage and gauge, beside the hysteresis: undone in mode strain, or awaited where it can't be undone.

    In mode stage it is the outer loop's model that has all of it.
    """

    delay_us: MicrosecondsOrZero = Field(
        default=0.0,
        description="Delay from set-point to position, without the bus. A known reference (hold, sine, step, file) "
        "leads by it, and the PID compares with the delayed set-point.",
    )
    gauge_us: MicrosecondsOrZero = Field(
        default=0.0,
        description="Delay from position to gauge reading, from the data sheet: 1e6/(2 pi bandwidth). The PID "
        "compares with the set-point delayed by it, too.",
    )
    lag_us: Microseconds | None = Field(
        default=None,
        description="First-order lag of the amplifier, not in delay_us; the feedforward leads the inverse's voltage "
        "by it. null: none.",
    )
    feedback_percent: Percent = Field(
        default=100.0,
        description="Share of the PID's gains that acts beside the feedforward; less feedback passes less of the "
        "gauge's noise.",
    )
    resonances: tuple[Resonance, ...] = Field(
        default=(),
        max_length=MAX_RESONANCES,
        description="Resonances that the feedforward inverts before the hysteresis.",
    )
