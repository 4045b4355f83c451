"""One axis: working point, hysteresis model, inner PID, outer LQG."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from micromanip.quantities import (
    Distance,
    Hertz,
    Micrometres,
    Milliseconds,
    MillisecondsOrZero,
    Percent,
    Positive,
    RangeUm,
    Real,
    Speed,
)
from micromanip.rt.laws.estimator import MAX_STATES

from .accept import Accept
from .actuator import Actuator
from .base import Settings
from .coupling import Coupling
from .faults import AxisFaults
from .hysteresis import Hysteresis, NoModel, PrandtlIshlinskii
from .key import AtRest, LargerIsWeaker, Live, NewStart

Row = tuple[Real, ...]
ToothRange = Annotated[float, Field(ge=0, le=5)]


class SetPoint(Settings):
    """Limits of the actuator set-point."""

    range_um: AtRest[RangeUm] = Field(description="Attainable range on the strain gauge.")
    slew_um_per_ms: Live[Speed] = Field(
        default=20.0,
        description="Slew limit. Keep it well below the output's slew limit (V/ms times um/V): the outer loop "
        "oscillates if the actuator cannot follow the set-point.",
    )


class Notch(Settings):
    """Band that is taken out of the PID's error, where the inner loop would drive a resonance of the stage."""

    frequency_Hz: Hertz = Field(description="Centre; below 0.45 times the gauge's sample rate.")
    width_Hz: Hertz = Field(description="Width between the half-power frequencies.")
    depth_percent: Percent = Field(default=95.0, description="Share of the error that is removed at the centre.")


class Inner(Settings):
    """PID on the strain gauge, equation (17)."""

    mode: Literal["pid", "pid+feedforward", "feedforward"] = Field(
        default="pid+feedforward", description="Source of the voltage: the PID, the inverse hysteresis model, or both."
    )
    K_V_per_um: Positive = Field(description="Proportional gain.")
    Ti_ms: Milliseconds = Field(description="Integral time.")
    Td_ms: MillisecondsOrZero = Field(description="Derivative time; 0: no derivative part.")
    filter_ms: MillisecondsOrZero = Field(description="Time constant of the derivative's filter.")
    tracking_ms: Milliseconds = Field(default=1.0, description="Time constant of the anti-windup.")
    notch: Notch | None = Field(default=None, description="Notch before the PID; null: none.")


UNTUNED = Inner(mode="pid", K_V_per_um=1e-3, Ti_ms=1e3, Td_ms=0.0, filter_ms=0.0)
"""The PID of an axis whose section `inner` is missing: it is never closed, `commission` finds the first."""


class LinearModel(Settings):
    """Stage position (um) from actuator set-point (um), one step per loop cycle, inner loop closed."""

    A: tuple[Row, ...] = Field(min_length=1, description="State matrix, row by row.")
    B: Row = Field(description="Input vector.")
    C: Row = Field(description="Output vector.")
    delay_cycles: int = Field(
        strict=True, ge=0, le=24, description="Actuation delay before the model, including the output's."
    )

    @model_validator(mode="after")
    def _sizes_agree(self) -> Self:
        n = len(self.A)
        if any(len(row) != n for row in self.A) or len(self.B) != n or len(self.C) != n:
            raise ValueError(f"A has {n} rows: every row of A, and B and C, must have {n} numbers")
        if n + self.delay_cycles + 3 > MAX_STATES:
            raise ValueError(
                f"order {n} plus delay {self.delay_cycles} is too large: at most {MAX_STATES - 3} together"
            )
        return self


class Outer(Settings):
    """Kalman filter and LQG on the capacitive sensor."""

    model: LinearModel
    control_weight: Positive = Field(
        default=10.0,
        description="LQR weight of the set-point, relative to the error's 1; smaller is faster and less robust.",
    )
    input_noise_um: Distance = Field(default=0.1, description="White noise on the set-point, rms per cycle.")
    disturbance_um: Distance = Field(
        default=0.1, description="Random walk of the input disturbance, rms per cycle: integral action."
    )
    oscillation_Hz: Hertz | None = Field(default=200.0, description="Tooth-passing frequency to cancel; null: none.")
    oscillation_um: Distance = Field(default=1e-3, description="Noise of that oscillator, rms per cycle.")
    oscillation_range_percent: ToothRange = Field(
        default=0.0,
        description="Range about oscillation_Hz in which the tooth's frequency is estimated and followed; 0: fixed.",
    )
    sensor_noise_um: Distance = Field(default=0.012, description="Noise of the capacitive sensor, rms.")
    sample_cycles: int = Field(default=1, strict=True, ge=1, le=64, description="Loop cycles between sensor samples.")

    @property
    def follows_tooth(self) -> bool:
        """Whether the frequency of the tooth is followed."""
        return self.oscillation_Hz is not None and self.oscillation_range_percent > 0.0

    def without_tooth(self) -> Outer:
        """The same without the oscillator."""
        return self.model_copy(update={"oscillation_Hz": None})


HASH_DIGITS = 16


class Commissioned(Settings):
    """What `commission` notes beside the tuning that it wrote; `check` and `run` warn where the two differ."""

    hash: str = Field(
        pattern=f"^[0-9a-f]{{{HASH_DIGITS}}}$",
        description="Hash of the axis' tuning: its keys and values without limits, authority and this section.",
    )
    report: str = Field(min_length=1, description="File of the report, relative to the folder of the results.")
    date: str = Field(min_length=1, description="Day of the commissioning.")
    less: str | None = Field(
        default=None, description="What was asked for and not reached: the axis is proven, and less accurate."
    )


class Axis(Settings):
    """One axis of the manipulator."""

    mode: AtRest[Literal["voltage", "strain", "stage"]] = Field(
        default="stage",
        description="Quantity that follows the reference: a voltage (open loop), an actuator or a stage position.",
    )
    centre_um: AtRest[Micrometres] = Field(description="Working point on the strain gauge: the stage's zero.")
    setpoint: SetPoint
    hysteresis: Live[Hysteresis] = Field(
        default=NoModel(model="none"), description="Hysteresis model; its inverse is the feedforward."
    )
    hysteresis_affine: Live[PrandtlIshlinskii | None] = Field(
        default=None, description="Affine model for configuration B of `evaluate`; `run` does not use it."
    )
    inner: Live[Inner] = Field(
        default=UNTUNED, description="PID on the strain gauge; without it the axis is untuned, and in mode voltage."
    )
    actuator: Live[Actuator | None] = Field(
        default=None, description="Linear dynamics that the feedforward inverts beside the hysteresis; null: none."
    )
    outer: Live[Outer | None] = Field(default=None, description="Outer loop; mode stage needs it.")
    coupling: Live[Coupling | None] = Field(
        default=None, description="Response of this stage to the other axes' motion; null: not measured."
    )
    authority_percent: Live[Percent] = Field(
        default=100.0, description="Share of the reference signal that the axis follows."
    )
    faults: LargerIsWeaker[Live[AxisFaults]] = Field(
        default=AxisFaults(), description="Limits of this axis; missing keys come from faults.axis."
    )
    accept: NewStart[Accept] = Field(default=Accept(), description="Acceptance limits of `commission`.")
    commissioned: Live[Commissioned | None] = Field(default=None, description="Report that belongs to this tuning.")

    @property
    def untuned(self) -> bool:
        """Whether nothing is known yet by which a loop could be closed."""
        return self.inner is UNTUNED or self.inner == UNTUNED

    @property
    def undone(self) -> Actuator | None:
        """The section `actuator` where it acts: there is a feedforward, and no outer loop whose model has all of it."""
        return self.actuator if self.mode == "strain" and self.inner.mode != "pid" else None

    @property
    def running_inner(self) -> Inner:
        """The PID with the gain that runs."""
        if self.undone is None:
            return self.inner
        gain = 0.01 * self.undone.feedback_percent * self.inner.K_V_per_um
        return self.inner.model_copy(update={"K_V_per_um": gain})

    def tuning(self) -> dict[str, Any]:
        """What a commissioning report is about: all but the note of it, what it must reach, limits and authority."""
        return self.model_dump(mode="json", exclude={"commissioned", "faults", "authority_percent", "accept"})

    @model_validator(mode="before")
    @classmethod
    def _untuned_in_open_loop(cls, section: Any) -> Any:
        """An axis without `inner` and `mode` is in mode voltage."""
        if isinstance(section, dict) and "inner" not in section and "mode" not in section:
            return {**section, "mode": "voltage"}
        return section

    @model_validator(mode="after")
    def _is_reachable(self) -> Self:
        low, high = self.setpoint.range_um
        if not low <= self.centre_um <= high:
            raise ValueError(f"centre_um {self.centre_um:g} is outside setpoint.range_um {low:g}..{high:g}")
        if self.mode != "voltage" and self.untuned:
            raise ValueError(
                f"mode {self.mode} needs the section inner; without it the axis is untuned: leave mode out, the axis "
                "moves in open loop (mode voltage), and `commission` tunes it"
            )
        if self.mode == "stage" and self.outer is None:
            raise ValueError("mode stage needs the section outer; mode strain does without")
        if self.inner.mode != "pid" and isinstance(self.hysteresis, NoModel) and self.mode != "voltage":
            raise ValueError(f"inner.mode {self.inner.mode} needs a hysteresis model; use mode: pid without one")
        return self
