"""How a held axis of a configuration may be moved: as far, as fast and as high in voltage as its limits allow.

What is not allowed is refused with what would be; nothing is clipped. The hand of a person may be near: a move begins
and ends at rest, goes no faster than half of what the limits allow, and shakes no flexure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from micromanip.control.moves import Move
from micromanip.errors import CheckFailed, require_axis
from micromanip.quantities import Distance, Micrometres
from micromanip.rt.laws.feedforward import NONE, feedforward_voltage
from micromanip.rt.laws.move import MAX_PLACES

from .schema.base import Settings
from .schema.model import Configuration

_SHARE = 0.5
"""Of the slew limits."""
_LONGEST_S, _STOP_S, _FADE_S = 60.0, 0.3, 0.3
_SHORTEST_S, _SMALL_UM, _CALM_HZ, _HIGHEST_HZ = 0.1, 1.0, 10.0, 200.0
"""A way of more than a micrometre takes so long, and above `_CALM_HZ` no amplitude is larger: flexures resonate."""
_TAKES = {
    "step": ("by_um",),
    "sine": ("amplitude_um", "frequency_Hz", "seconds"),
    "sweep": ("amplitude_um", "frequency_Hz", "to_Hz", "seconds"),
    "waypoints": ("places_um",),
}

_Time = Annotated[float, Field(strict=True, ge=0.01, le=_LONGEST_S, allow_inf_nan=False)]
_Rest = Annotated[float, Field(strict=True, ge=0, le=_LONGEST_S, allow_inf_nan=False)]
_Frequency = Annotated[float, Field(strict=True, ge=0.05, le=_HIGHEST_HZ, allow_inf_nan=False)]


class MoveRequest(Settings):
    """What somebody asks for; lengths from where the axis is held."""

    kind: Literal["step", "sine", "sweep", "waypoints"] = Field(description="What kind of move.")
    by_um: Micrometres | None = Field(default=None, description="Of a step.")
    returns: bool = Field(default=True, strict=True, description="A step comes back; waypoints end where they began.")
    way_s: _Time = Field(default=0.2, description="How long a step, or the way to the next place, takes.")
    rest_s: _Rest = Field(default=0.5, description="How long it rests there.")
    amplitude_um: Distance | None = Field(default=None, description="Of a sine or a sweep: half of peak to peak.")
    frequency_Hz: _Frequency | None = Field(default=None, description="Of a sine, or where a sweep begins.")
    to_Hz: _Frequency | None = Field(default=None, description="Where a sweep ends.")
    seconds: _Time | None = Field(default=None, description="Length of a sine or a sweep.")
    places_um: tuple[Micrometres, ...] | None = Field(
        default=None, min_length=1, max_length=MAX_PLACES - 1, description="Waypoints."
    )

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        optional = {name for names in _TAKES.values() for name in names}
        given = {name for name in optional if getattr(self, name) is not None}
        if given != set(_TAKES[self.kind]):
            raise ValueError(f"{self.kind} takes {', '.join(_TAKES[self.kind])}, and none of the others")
        return self


@dataclass(frozen=True)
class HeldAxis:
    """Where the axis is held: of its parameters and state as the loop has them."""

    parameters: Any
    state: Any

    @property
    def stage(self) -> bool:
        """Whether its place is that of the stage, by the outer loop; else that of the actuator."""
        return bool(self.parameters["mode"] == 2)


def plan_move(configuration: Configuration, axis: str, wanted: MoveRequest, held: HeldAxis) -> Move:
    """The move as it will be played.

    Raises UsageError where there is no such axis, CheckFailed where it is in mode voltage, or the move would leave what
    is allowed.
    """
    require_axis(axis, configuration.axes)
    if configuration.axes[axis].mode == "voltage":
        raise CheckFailed(f"move refused: axis {axis} is in mode voltage, its loops are open")
    rate_hz = float(configuration.loop.rate_hz)
    move = _of(wanted, rate_hz)
    if move.cycles > _LONGEST_S * rate_hz:
        raise CheckFailed(f"move refused: it takes {move.cycles / rate_hz:.1f} s, at most {_LONGEST_S:g} s")
    _refuse_shaking(wanted)
    _refuse_beyond(axis, move, held, rate_hz)
    return move


def _of(wanted: MoveRequest, rate_hz: float) -> Move:
    stop, way, rest = (max(1, round(s * rate_hz)) for s in (_STOP_S, wanted.way_s, wanted.rest_s))
    if wanted.kind in ("sine", "sweep"):
        assert wanted.seconds is not None
        assert wanted.frequency_Hz is not None
        cycles = round(wanted.seconds * rate_hz)
        fade = min(round(max(_FADE_S, 1.0 / wanted.frequency_Hz) * rate_hz), cycles // 2)
        first, last = wanted.frequency_Hz / rate_hz, (wanted.to_Hz or wanted.frequency_Hz) / rate_hz
        return Move((), cycles, stop, float(wanted.amplitude_um or 0.0), max(1, fade), first, last)
    places = (float(wanted.by_um or 0.0),) if wanted.places_um is None else wanted.places_um
    if wanted.returns:
        places = (*places, 0.0)
    return Move(tuple((um, way, rest) for um in places), len(places) * (way + rest), stop)


def _refuse_shaking(wanted: MoveRequest) -> None:
    highest = max(wanted.frequency_Hz or 0.0, wanted.to_Hz or 0.0)
    if highest > _CALM_HZ and (wanted.amplitude_um or 0.0) > _SMALL_UM:
        raise CheckFailed(
            f"move refused: above {_CALM_HZ:g} Hz a flexure may resonate, at most {_SMALL_UM:g} um of amplitude there"
        )
    places = (0.0, *(wanted.places_um or (wanted.by_um or 0.0,)), *((0.0,) if wanted.returns else ()))
    longest = float(np.abs(np.diff(places)).max(initial=0.0))
    if wanted.kind in ("step", "waypoints") and longest > _SMALL_UM and wanted.way_s < _SHORTEST_S:
        raise CheckFailed(
            f"move refused: a way of {longest:g} um in {wanted.way_s:g} s may shake the flexure; way_s of at least "
            f"{_SHORTEST_S:g} s beyond {_SMALL_UM:g} um"
        )


def _refuse_beyond(axis: str, move: Move, held: HeldAxis, rate_hz: float) -> None:
    """What the set-point and the voltage would be, by the models of the loops, against their limits."""
    p, s = held.parameters, held.state
    now_um, gain = float(s["setpoint_um"]), float(p["outer"]["reference"][0]) if held.stage else 1.0
    path = now_um + gain * move.looked_at()
    low, high = float(p["setpoint_low_um"]), float(p["setpoint_high_um"])
    if path.min() < low or path.max() > high:
        raise CheckFailed(
            f"move refused: it would take the set-point of axis {axis} from {path.min():.1f} to {path.max():.1f} um, "
            f"setpoint.range_um is {low:g} to {high:g} um; it is held at {now_um:.1f} um"
        )
    speed, allowed = abs(gain) * move.fastest, _SHARE * float(p["setpoint_slew_um"])
    if speed > allowed:
        raise CheckFailed(
            f"move refused: it would move the set-point of axis {axis} at {speed * rate_hz:.0f} um/s, at most "
            f"{allowed * rate_hz:.0f} um/s: {100 * _SHARE:.0f} % of setpoint.slew_um_per_ms"
        )
    volts, slope = _voltages(p, s, path)
    limits = p["limiter"]
    if volts.min() < limits["low_V"] or volts.max() > limits["high_V"]:
        raise CheckFailed(
            f"move refused: it would take the voltage of axis {axis} from {volts.min():.1f} to {volts.max():.1f} V, "
            f"its range is {limits['low_V']:g} to {limits['high_V']:g} V"
        )
    if slope * speed > _SHARE * float(limits["slew_V"]):
        raise CheckFailed(
            f"move refused: it would change the voltage of axis {axis} by {slope * speed * rate_hz * 1e-3:.2g} V/ms, "
            f"at most {_SHARE * float(limits['slew_V']) * rate_hz * 1e-3:.2g} V/ms: half of its slew limit"
        )


def _voltages(p: Any, s: Any, path: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Voltages (n,) at set-points `path` (n,), and the steepest slope between them, V per um.

    The feedforward from the state that it is in, the feedback as it is; without a model as the ranges are to each
    other, and a quarter more.
    """
    limits, now_V = p["limiter"], float(s["voltage_V"])
    if p["hysteresis"]["kind"] == NONE:
        slope = 1.25 * float((limits["high_V"] - limits["low_V"]) / (p["setpoint_high_um"] - p["setpoint_low_um"]))
        return now_V + slope * (path - path[0]), slope
    memory = s["hysteresis"].copy()
    volts = np.array([feedforward_voltage(p["hysteresis"], memory, float(um)) for um in path])
    moved = np.abs(np.diff(path))
    slopes = np.abs(np.diff(volts))[moved > 1e-6] / moved[moved > 1e-6]
    return volts + (now_V - volts[0]), float(slopes.max(initial=0.0))
