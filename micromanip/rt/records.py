"""Layout of everything the loop reads and writes: fixed, padded sizes, physical units.

One layout for every configuration, so that nothing recompiles: a model with six plays uses the
first six places. Lengths are in um, voltages in V, times in s or, with the suffix, ns.
Parameters never hold state and states never hold parameters: ``step(parameters, state, input)``.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from .states import FAULTS

Record: TypeAlias = Any
"""One numpy structured scalar; compiled code sees its fields by name."""

MAX_AXES = 3
MAX_PLAYS = 32
MAX_TABLE = 64
MAX_CREEP = 8
MAX_NEURONS = 32
MAX_STATES = 32
"""A multiple of 4; a model behind a slow bus has a state for each cycle of its delay."""
MAX_SINES = 8
MAX_DRIVERS = 4
MAX_SIGNALS = 48
MAX_OUTPUTS = 8
INPUT_HISTORY = 256
"""Cycles that estimator and axis remember (a power of two): a sample may be that many cycles old."""
MAX_FRAME = 6
"""Coordinates that a tracker may have."""
REFERENCE_STATES = 5
EVENTS = 32
"""Events that the loop remembers."""


def _record(*fields: tuple[Any, ...]) -> np.dtype[Any]:
    return np.dtype(list(fields), align=True)


SIGNAL = _record(("value", "f8"), ("time_ns", "i8"), ("sequence", "i8"), ("status", "i8"))
"""One input as a driver leaves it; ``sequence`` grows by one a fresh sample, ``status`` 0 is good."""

SHAPING = _record(
    ("kind", "i8"), ("c", "f8", (4,)), ("points", "i8"), ("v", "f8", (MAX_TABLE,)), ("u", "f8", (MAX_TABLE,))
)

HYSTERESIS_PARAMETERS = _record(
    ("kind", "i8"),
    ("shaping", SHAPING),
    ("plays", "i8"),
    ("alpha", "f8"),
    ("r", "f8", (MAX_PLAYS,)),
    ("rho", "f8", (MAX_PLAYS,)),
    ("r_hat", "f8", (MAX_PLAYS,)),
    ("rho_hat", "f8", (MAX_PLAYS,)),
    ("rate_cycles", "f8"),
    ("creeps", "i8"),
    ("creep_gain", "f8", (MAX_CREEP,)),
    ("creep_step", "f8", (MAX_CREEP,)),
    ("low_um", "f8"),
    ("high_um", "f8"),
    ("neurons", "i8"),
    ("reversal_um", "f8"),
    ("w_in", "f8", (MAX_NEURONS, 3)),
    ("b_in", "f8", (MAX_NEURONS,)),
    ("w_out", "f8", (MAX_NEURONS,)),
    ("b_out", "f8"),
)
HYSTERESIS_STATE = _record(
    ("z", "f8", (MAX_PLAYS,)),
    ("creep_um", "f8", (MAX_CREEP,)),
    ("u_um", "f8"),
    ("change_um", "f8"),
    ("y_memory", "f8"),
    ("v_memory", "f8"),
    ("y_last", "f8"),
    ("v_last", "f8"),
    ("y_extreme", "f8"),
    ("direction", "f8"),
    ("output_V", "f8"),
)

PID_PARAMETERS = _record(
    ("gain", "f8"), ("integral", "f8"), ("derivative", "f8"), ("filter_s", "f8"), ("period_s", "f8"), ("tracking", "f8")
)
PID_STATE = _record(("integrator", "f8"), ("derivative", "f8"), ("error", "f8"), ("output_V", "f8"))

OUTER_PARAMETERS = _record(
    ("states", "i8"),
    ("a_columns", "f8", (MAX_STATES, MAX_STATES)),
    ("b", "f8", (MAX_STATES,)),
    ("c", "f8", (MAX_STATES,)),
    ("gain", "f8", (MAX_STATES,)),
    ("feedback", "f8", (MAX_STATES,)),
    ("reference", "f8", (REFERENCE_STATES,)),
    ("steady_u", "f8", (MAX_STATES,)),
    ("steady_y", "f8", (MAX_STATES,)),
    ("slow", "i8"),
    ("innovation_um", "f8"),
    ("repeated_um", "f8"),
    ("gap_cycles", "i8"),
)
"""``slow``: the first of the states that are disturbances; ``innovation_um``: how large an innovation may be at once,
``repeated_um`` of a reading that is the same for the third time; ``gap_cycles``: samples further apart than that leave
the estimate uncertain."""
ESTIMATOR_STATE = _record(
    ("filtered", "f8", (MAX_STATES,)),
    ("x", "f8", (MAX_STATES,)),
    ("scratch", "f8", (MAX_STATES,)),
    ("filtered_cycle", "i8"),
    ("cycle", "i8"),
    ("history", "f8", (INPUT_HISTORY,)),
    ("innovation_um", "f8"),
    ("opened_um", "f8"),
    ("reading_um", "f8"),
    ("repeated", "i8"),
    ("running", "i8"),
)

REFERENCE_PARAMETERS = _record(
    ("kind", "i8"),
    ("offset_um", "f8"),
    ("start_s", "f8"),
    ("step_um", "f8"),
    ("sines", "i8"),
    ("amplitude_um", "f8", (MAX_SINES,)),
    ("omega", "f8", (MAX_SINES,)),
    ("phase", "f8", (MAX_SINES,)),
    ("samples_per_s", "f8"),
    ("column", "i8"),
    ("predict", "i8"),
    ("oscillator", "f8"),
    ("gain", "f8", (REFERENCE_STATES,)),
    ("horizon_s", "f8"),
    ("low_um", "f8"),
    ("high_um", "f8"),
    ("jump_um", "f8"),
    ("target_um", "f8"),
    ("speed_um", "f8"),
    ("smoothing", "f8"),
)
REFERENCE_STATE = _record(
    ("filtered", "f8", (REFERENCE_STATES,)),
    ("w", "f8", (REFERENCE_STATES,)),
    ("time_ns", "i8"),
    ("sequence", "i8"),
    ("sampled_um", "f8"),
    ("rejected", "i8"),
    ("silent", "i8"),
    ("followed", "i8"),
    ("doubted", "i8"),
    ("jog_um", "f8"),
    ("jog_step_um", "f8"),
)

LIMITER_PARAMETERS = _record(("low_V", "f8"), ("high_V", "f8"), ("slew_V", "f8"), ("park_V", "f8"))

LINE_PARAMETERS = _record(("signal", "i8"), ("age_ns", "i8"))
"""A digital input: its place in the image (-1: not wired), and how old it may be."""

WATCH_PARAMETERS = _record(
    ("reaction", "i8", (FAULTS,)),
    ("strain_samples", "i8"),
    ("strain_identical", "i8"),
    ("coast_cycles", "i8"),
    ("stage_samples", "i8"),
    ("stage_identical", "i8"),
    ("degraded_cycles", "i8"),
    ("decay_cycles", "i8"),
    ("bridged_cycles", "i8"),
    ("innovation_variance", "f8"),
    ("innovation_ratio", "f8"),
    ("innovation_step", "f8"),
    ("following_um", "f8"),
    ("following_cycles", "i8"),
    ("saturating_cycles", "i8"),
    ("saturated_cycles", "i8"),
    ("band_b", "f8", (3,)),
    ("band_a1", "f8"),
    ("band_a2", "f8"),
    ("band_um", "f8"),
    ("band_step", "f8"),
    ("band_cycles", "i8"),
    ("stale_cycles", "i8"),
    ("lost_cycles", "i8"),
    ("derate", "f8"),
    ("hot_cycles", "i8"),
    ("swings", "i8"),
    ("swing_cycles", "i8"),
)
"""Limits of the fault detection of one axis; times in cycles."""
SWING = _record(("end", "i8"), ("times", "i8"), ("first_cycle", "i8"))
"""What went from one end of its range to the other: where it was last (-1, 1; 0: none yet), how often, since when."""
WATCH_STATE = _record(
    ("raised", "i8"),
    ("coast", "i8"),
    ("degraded", "i8"),
    ("innovation", "f8"),
    ("following", "i8"),
    ("saturated", "i8"),
    ("band_x1", "f8"),
    ("band_x2", "f8"),
    ("band_y1", "f8"),
    ("band_y2", "f8"),
    ("band_energy", "f8"),
    ("band_cycles", "i8"),
    ("fallback", "i8"),
    ("hot", "i8"),
    ("driven_swing", SWING),
    ("strain_swing", SWING),
    ("stage_swing", SWING),
)

CHECK_PARAMETERS = _record(("step", "f8"), ("low", "f8"), ("high", "f8"))
"""Polarity and scale check: height of the step, and between what the answer to it must lie."""
CHECK_STATE = _record(
    ("before", "f8"),
    ("after", "f8"),
    ("before_samples", "i8"),
    ("after_samples", "i8"),
    ("turn", "i8"),
    ("found", "f8"),
    ("passed", "i8"),
)
"""What a check gathers; its place among the axes that are checked in this arming (1 is the first, 0: it is not due);
what it found last, and whether that was as expected and still counts."""

AXIS_PARAMETERS = _record(
    ("mode", "i8"),
    ("strain", "i8"),
    ("stage", "i8"),
    ("deviation", "i8"),
    ("true_strain", "i8"),
    ("true_stage", "i8"),
    ("path_error", "i8"),
    ("uncompensated", "i8"),
    ("voltage", "i8"),
    ("strain_age_ns", "i8"),
    ("stage_age_ns", "i8"),
    ("reference_age_ns", "i8"),
    ("strain_range_um", "f8", (2,)),
    ("stage_range_um", "f8", (2,)),
    ("strain_rate_um_per_ns", "f8"),
    ("stage_rate_um_per_ns", "f8"),
    ("amplifier_ok", LINE_PARAMETERS),
    ("temperature_ok", LINE_PARAMETERS),
    ("cycles_per_ns", "f8"),
    ("answer_cycles", "i8"),
    ("centre_um", "f8"),
    ("setpoint_low_um", "f8"),
    ("setpoint_high_um", "f8"),
    ("setpoint_slew_um", "f8"),
    ("sweep_um", "f8"),
    ("authority", "f8"),
    ("authority_step", "f8"),
    ("blend_decay", "f8"),
    ("feedback", "i8"),
    ("hysteresis", HYSTERESIS_PARAMETERS),
    ("pid", PID_PARAMETERS),
    ("fallback", PID_PARAMETERS),
    ("outer", OUTER_PARAMETERS),
    ("reference", REFERENCE_PARAMETERS),
    ("limiter", LIMITER_PARAMETERS),
    ("watch", WATCH_PARAMETERS),
    ("strain_check", CHECK_PARAMETERS),
    ("stage_check", CHECK_PARAMETERS),
)
SENSOR_STATE = _record(
    ("value", "f8"),
    ("time_ns", "i8"),
    ("sequence", "i8"),
    ("arrived_ns", "i8"),
    ("taken_ns", "i8"),
    ("reading", "f8"),
    ("age_ns", "i8"),
    ("silent_ns", "i8"),
    ("fresh", "i8"),
    ("bad", "i8"),
    ("identical", "i8"),
    ("lost", "i8"),
)
FIGURES = _record(("error", "f8"), ("innovation", "f8"), ("feedback", "f8"))
"""Mean squares over about a second: error (um^2), innovation (um^2), and what the PID adds to the feedforward (V^2)."""

AXIS_STATE = _record(
    ("strain", SENSOR_STATE),
    ("stage", SENSOR_STATE),
    ("deviation", SENSOR_STATE),
    ("amplifier_ok", SENSOR_STATE),
    ("temperature_ok", SENSOR_STATE),
    ("watch", WATCH_STATE),
    ("figures", FIGURES),
    ("strain_check", CHECK_STATE),
    ("stage_check", CHECK_STATE),
    ("hysteresis", HYSTERESIS_STATE),
    ("pid", PID_STATE),
    ("estimator", ESTIMATOR_STATE),
    ("reference", REFERENCE_STATE),
    ("setpoints", "f8", (INPUT_HISTORY,)),
    ("references", "f8", (INPUT_HISTORY,)),
    ("wanted_cycle", "i8"),
    ("strain_error_um", "f8"),
    ("stage_error_um", "f8"),
    ("path_um", "f8"),
    ("error_fresh", "i8"),
    ("strain_cycles", "i8"),
    ("closed", "i8"),
    ("frozen", "i8"),
    ("refused", "i8"),
    ("start_um", "f8"),
    ("start_V", "f8"),
    ("offset", "f8"),
    ("hold_um", "f8"),
    ("hold_scale", "f8"),
    ("authority", "f8"),
    ("blend_um", "f8"),
    ("setpoint_um", "f8"),
    ("request_V", "f8"),
    ("voltage_V", "f8"),
    ("errors", "i8"),
    ("error_squares", "f8"),
    ("error_max", "f8"),
    ("uncompensated_squares", "f8"),
)

FRAME = _record(
    ("sources", "i8"),
    ("source", "i8", (MAX_FRAME,)),
    ("derived", "i8"),
    ("first", "i8"),
    ("matrix", "f8", (MAX_AXES, MAX_FRAME)),
    ("offset", "f8", (MAX_AXES,)),
)
"""Derived signals: places of their sources in the image, their number, their first place."""
CELL_PARAMETERS = _record(
    ("version", "i8"),
    ("axes", "i8"),
    ("period_ns", "i8"),
    ("enable_cycles", "i8"),
    ("check_cycles", "i8"),
    ("lift_cycles", "i8"),
    ("sweep_cycles", "i8"),
    ("sweep_turns", "f8"),
    ("settle_cycles", "i8"),
    ("authority_cycles", "i8"),
    ("ramp_cycles", "i8"),
    ("score_cycles", "i8"),
    ("heartbeat_ns", "i8"),
    ("overruns_in_a_row", "i8"),
    ("overrun_share", "f8"),
    ("overrun_level", "f8"),
    ("hold_cycles", "i8"),
    ("reaction", "i8", (FAULTS,)),
    ("enable", LINE_PARAMETERS),
    ("interlock", LINE_PARAMETERS),
    ("retracted", LINE_PARAMETERS),
    ("amplifier_enable", "i8"),
    ("feed_hold", "i8"),
    ("heartbeat", "i8"),
    ("heartbeat_cycles", "i8"),
    ("frame", FRAME),
    ("figures_step", "f8"),
    ("trial_cycles", "i8"),
    ("trial_rest", "i8"),
    ("trial_step", "f8"),
    ("trial_factor", "f8"),
    ("trial_floor", "f8"),
    ("axis", AXIS_PARAMETERS, (MAX_AXES,)),
)
EVENT = _record(
    ("cycle", "i8"),
    ("code", "i8"),
    ("axis", "i8"),
    ("value", "f8"),
    ("limit", "f8"),
    ("reaction", "i8"),
    ("state", "i8"),
)
"""A fault or a warning as it was raised: when, what, on which axis (-1: the cell), measured and limit."""
CELL_STATE = _record(
    ("state", "i8"),
    ("phase", "i8"),
    ("stopping", "i8"),
    ("soft", "i8"),
    ("resumed", "i8"),
    ("probes", "i8"),
    ("bumps", "i8"),
    ("entered_cycle", "i8"),
    ("cycle", "i8"),
    ("tracking_cycle", "i8"),
    ("fault", "i8"),
    ("fault_axis", "i8"),
    ("fault_value", "f8"),
    ("fault_limit", "f8"),
    ("fault_cycle", "i8"),
    ("former", "i8"),
    ("former_axis", "i8"),
    ("former_value", "f8"),
    ("former_limit", "f8"),
    ("trips", "i8"),
    ("raised", "i8"),
    ("events", "i8"),
    ("event", EVENT, (EVENTS,)),
    ("refused", "i8"),
    ("link_down", "i8"),
    ("outputs_taken", "i8"),
    ("outputs_away", "i8"),
    ("enable", SENSOR_STATE),
    ("interlock", SENSOR_STATE),
    ("retracted", SENSOR_STATE),
    ("frame_sequence", "i8", (MAX_FRAME,)),
    ("overruns", "i8"),
    ("overruns_in_a_row", "i8"),
    ("overrun_level", "f8"),
    ("version", "i8"),
    ("shadow", "i8"),
    ("trial_cycles", "i8"),
    ("trial_judged", "i8"),
    ("trial_overruns", "i8"),
    ("trial_rest", "i8"),
    ("trial_before", "f8", (MAX_AXES,)),
    ("trial_now", "f8", (MAX_AXES,)),
    ("axis", AXIS_STATE, (MAX_AXES,)),
)

AXIS_ROW = _record(
    ("reference_um", "f8"),
    ("deviation_um", "f8"),
    ("strain_um", "f8"),
    ("stage_um", "f8"),
    ("estimate_um", "f8"),
    ("innovation_um", "f8"),
    ("setpoint_um", "f8"),
    ("feedforward_V", "f8"),
    ("feedback_V", "f8"),
    ("voltage_V", "f8"),
    ("true_strain_um", "f8"),
    ("true_stage_um", "f8"),
    ("path_error_um", "f8"),
    ("uncompensated_um", "f8"),
    ("conditions", "i8"),
    ("strain_age_ns", "i4"),
    ("stage_age_ns", "i4"),
    ("deviation_age_ns", "i4"),
    ("fresh", "i4"),
)
ROW = _record(
    ("cycle", "i8"),
    ("time_ns", "i8"),
    ("lateness_ns", "i8"),
    ("compute_ns", "i8"),
    ("periods", "i4"),
    ("state", "i4"),
    ("fault", "i4"),
    ("version", "i4"),
    ("phase", "i4"),
    ("lines", "i4"),
    ("axis", AXIS_ROW, (MAX_AXES,)),
)
"""One cycle of telemetry; ``compute_ns`` is the time of the cycle before, ``fresh`` bit 0 strain,
1 stage, 2 deviation; what an axis does not have is NaN. ``conditions`` has a bit a code of ``states``
that is raised; ``lines`` bit 0 enable, 1 interlock, 2 retracted, 3 amplifier enable, 4 feed-hold."""

DRIVER = _record(
    ("exchange", "i8"),
    ("context", "i8"),
    ("first_input", "i8"),
    ("first_output", "i8"),
)
"""A cyclic driver as the loop calls it: addresses, and where its channels begin in the image."""
