"""States, phases, commands, reactions and fault codes that the loop, the host and the clients share: plain integers."""

from __future__ import annotations

OFF, STARTING, READY, ARMING, TRACKING, HOLDING, RAMPING, FAULT = range(8)
STATE_NAMES = ("OFF", "STARTING", "READY", "ARMING", "TRACKING", "HOLDING", "RAMPING", "FAULT")

PARKED, CHECKING_GAUGE, LIFTING, CHECKING_STAGE, SWEEPING, CLOSED, PARKING, FROZEN = range(8)
"""What an axis does in a cycle: rests at the park voltage; makes a small voltage step (check of the gauge);
is brought to its working point with the inner loop; makes a small step there (check of the stage); is swept with
falling amplitude; follows the reference; goes back to the park voltage; keeps its voltage."""
DRIVEN = (LIFTING, CHECKING_STAGE, SWEEPING, CLOSED)
"""With its law at work."""

PHASE_NAMES = ("parked", "gauge check", "lift", "stage check", "sweep", "closed", "parking", "frozen")

NO_COMMAND, ARM, DISARM, STOP, RESET, HOLD, PROMOTE, WITHDRAW, BEGIN_PART, END_PART = range(10)
COMMAND_NAMES = ("", "arm", "disarm", "stop", "reset", "hold", "promote", "withdraw", "part begin", "part end")

NO_SHADOW, SHADOWING, ON_TRIAL, CONFIRMED, TAKEN_BACK = range(5)
SHADOW_NAMES = ("none", "shadowing", "on trial", "confirmed", "taken back")
"""A candidate tuning: none, computing beside the active one, on trial, confirmed, or taken back."""

WARN, HOLDS, RAMPS, CUTS = range(4)
REACTION_NAMES = ("warn", "hold", "ramp", "off")
"""What a fault does: it is only reported; the correction is frozen; smoothly to park; the amplifier is switched off."""

(
    NO_FAULT,
    HOST_DEAD,
    OVERRUNS,
    DRIVER_ERROR,
    STRAIN_INVALID,
    STAGE_INVALID,
    NOT_FINITE,
    STRAIN_STUCK,
    STAGE_STUCK,
    DISAGREEMENT,
    FOLLOWING_ERROR,
    SATURATED,
    OSCILLATION,
    REFERENCE_LOST,
    AMPLIFIER_FAULT,
    OVER_TEMPERATURE,
    ENABLE_LOST,
    INTERLOCK_OPEN,
    STRAIN_CHECK,
    STAGE_CHECK,
    LINK_LOST,
    OUTPUTS_TAKEN,
    LIMIT_CYCLE,
    STRAIN_SILENT,
    STAGE_DRIFT,
) = range(25)
FAULTS = 25
"""Faults: each has a reaction of its own, and the first that is more than a warning stays latched."""

(
    COASTING,
    DEGRADED,
    SATURATING,
    FALLBACK,
    REFERENCE_STALE,
    DERATED,
    ROLLED_BACK,
    TOOTH_LOST,
    OUTRUN,
    REFERENCE_STUCK,
) = range(FAULTS, FAULTS + 10)
"""Warnings: reported and written down as events, but never latched."""

EVENT_CODES = FAULTS + 10

WATCHED = (
    *(COASTING, STRAIN_SILENT, STRAIN_INVALID, STRAIN_STUCK, DEGRADED, STAGE_INVALID, STAGE_STUCK),
    *(DISAGREEMENT, STAGE_DRIFT, TOOTH_LOST, FOLLOWING_ERROR, SATURATING, SATURATED, FALLBACK, OSCILLATION),
    *(OUTRUN, LIMIT_CYCLE, REFERENCE_STALE, REFERENCE_STUCK, REFERENCE_LOST, AMPLIFIER_FAULT, DERATED),
    OVER_TEMPERATURE,
)
"""Conditions of one cycle are reported in this order."""

NOT_READY, LATCHED, ENABLE_MISSING, INTERLOCK_MISSING, LINK_MISSING, OUTPUTS_MISSING = 1, 2, 4, 8, 16, 32
"""Why arming was refused, the cell's bits."""
STRAIN_MISSING, REFERENCE_MISSING, AMPLIFIER_MISSING, TEMPERATURE_MISSING, NOT_RESUMABLE, STAGE_MISSING = (
    1,
    2,
    4,
    8,
    16,
    32,
)
"""Why arming was refused, an axis' bits."""

VOLTAGE, STRAIN, STAGE = range(3)
MODE_NAMES = ("voltage", "strain", "stage")
"""What an axis' reference is: a voltage (open loop), an actuator or a stage position."""
