"""Hysteresis models as they stand in the configuration."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from micromanip.quantities import Distance, MillisecondsOrZero, Positive, RangeUm, Real, Seconds, Volts
from micromanip.rt.laws.feedforward import MAX_CREEP
from micromanip.rt.laws.hysteresis import MAX_PLAYS, MAX_TABLE
from micromanip.rt.laws.network import MAX_NEURONS

from .base import Settings, is_rising

Range = tuple[float, float]


class _Ranged(Settings):
    range_um: RangeUm = Field(description="Valid range; the set-point is clipped to it before the inverse.")


class PrandtlIshlinskii(_Ranged):
    """Generalised Prandtl-Ishlinskii model (6); its inverse (7)-(9) is the feedforward."""

    model: Literal["pi"]
    shaping: Literal["identity", "affine", "tanh", "table"] = Field(description="Shaping function phi, from volts.")
    coefficients: tuple[Real, ...] = Field(
        default=(), description="affine: c1, c2 of (15); tanh: c3, c4, c5, c6 of (16); otherwise empty."
    )
    table_V: tuple[Volts, ...] = Field(default=(), max_length=MAX_TABLE, description="table: rising voltages.")
    table_um: tuple[Real, ...] = Field(default=(), max_length=MAX_TABLE, description="table: rising values of phi.")
    alpha: Positive = Field(default=1.0, description="Weight of the memoryless part.")
    thresholds_um: tuple[Distance, ...] = Field(
        max_length=MAX_PLAYS, description="Thresholds r_i of the play operators, rising, on phi(v)."
    )
    weights: tuple[Real, ...] = Field(max_length=MAX_PLAYS, description="Weights rho_i, one per threshold.")
    rate_ms: MillisecondsOrZero = Field(
        default=0.0,
        description="Rate dependence: every threshold grows by this times the speed of phi(v) (um/ms).",
    )
    creep_s: tuple[Seconds, ...] = Field(
        default=(), max_length=MAX_CREEP, description="Creep: time constants of first-order lags of phi(v)."
    )
    creep_gains: tuple[Real, ...] = Field(
        default=(), max_length=MAX_CREEP, description="Weights of the creep, one per time constant."
    )

    @model_validator(mode="after")
    def _is_invertible(self) -> Self:
        wanted = {"identity": 0, "affine": 2, "tanh": 4, "table": 0}[self.shaping]
        if len(self.coefficients) != wanted:
            raise ValueError(
                f"coefficients: {self.shaping} shaping takes {wanted} numbers, not {len(self.coefficients)}"
            )
        if self.shaping == "affine" and self.coefficients[0] <= 0:
            raise ValueError("coefficients: the slope c1 of the affine shaping must be positive")
        if self.shaping == "tanh" and self.coefficients[0] * self.coefficients[1] <= 0:
            raise ValueError("coefficients: c3 and c4 of the tanh shaping must have the same sign (phi must rise)")
        if len(self.table_V) != len(self.table_um) or (self.shaping == "table" and len(self.table_V) < 2):
            raise ValueError("table_V and table_um need the same number of points, at least 2")
        if not (is_rising(self.table_V) and is_rising(self.table_um)):
            raise ValueError("table_V and table_um must rise from point to point")
        if len(self.thresholds_um) != len(self.weights):
            raise ValueError(
                f"weights: {len(self.thresholds_um)} thresholds need as many weights, not {len(self.weights)}"
            )
        if not is_rising(self.thresholds_um):
            raise ValueError("thresholds_um must rise")
        partial = self.alpha
        for number, weight in enumerate(self.weights, start=1):
            partial += weight
            if partial <= 0:
                raise ValueError(
                    f"weights: alpha plus the first {number} weights is {partial:.4g}; every partial sum must be "
                    "positive for the inverse to exist"
                )
        if len(self.creep_s) != len(self.creep_gains):
            raise ValueError(
                f"creep_gains: {len(self.creep_s)} creep_s need as many gains, not {len(self.creep_gains)}"
            )
        if sum(self.creep_gains) <= -partial:
            raise ValueError(
                f"creep_gains: their sum {sum(self.creep_gains):.4g} must be above -{partial:.4g} "
                "(alpha plus all weights), or the inverse runs away"
            )
        return self


Weights3 = tuple[Real, Real, Real]


class Network(_Ranged):
    """Recurrent-network inverse (10)-(12), displacement (um) to voltage (V)."""

    model: Literal["network"]
    reversal_um: Distance = Field(
        description="The memory moves to the last turning point after a return of the set-point by more than this."
    )
    input_weights: tuple[Weights3, ...] = Field(
        min_length=1, max_length=MAX_NEURONS, description="w(1): a row [y_k, y_m, v_m] per neuron."
    )
    input_biases: tuple[Real, ...] = Field(description="b(1), one per neuron.")
    output_weights: tuple[Real, ...] = Field(description="w(2), one per neuron.")
    output_bias: Real = Field(description="b(2).")

    @model_validator(mode="after")
    def _sizes_agree(self) -> Self:
        neurons = len(self.input_weights)
        if len(self.input_biases) != neurons or len(self.output_weights) != neurons:
            raise ValueError(
                f"input_weights, input_biases and output_weights must have one entry a neuron ({neurons}), "
                f"not {len(self.input_biases)} and {len(self.output_weights)}"
            )
        return self


class NoModel(Settings):
    """No feedforward: pure feedback."""

    model: Literal["none"]


Hysteresis = Annotated[PrandtlIshlinskii | Network | NoModel, Field(discriminator="model")]


def phi_range(model: PrandtlIshlinskii) -> Range:
    """Values the shaping can take."""
    if model.shaping != "tanh":
        return -math.inf, math.inf
    centre, half = model.coefficients[3], abs(model.coefficients[0])
    return centre - half, centre + half


def attainable_um(model: PrandtlIshlinskii) -> Range:
    """Displacements on the major loop between the ends of the shaping function: beyond them there is no inverse."""
    low, high = phi_range(model)
    if not math.isfinite(low):
        return low, high
    gain = model.alpha + sum(model.weights) + sum(model.creep_gains)
    # each play hangs back by its threshold, or has not moved at all where it is wider than the range
    behind = sum(
        weight * (min(2.0 * r, high - low) - r) for weight, r in zip(model.weights, model.thresholds_um, strict=True)
    )
    return gain * low + behind, gain * high - behind
