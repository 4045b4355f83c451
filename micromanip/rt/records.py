"""What the loop reads and writes, put together of the laws' own records: process image, axis, cell.

Parameters and state of a law stand beside the law, in ``laws/``; those of what is watched, checked and scored, events
and the telemetry row likewise beside what fills them. How a record is laid out, and its units: ``record.py``. What each
cycle reads and writes lies together, what is large or seldom needed behind it: a cold cache costs more than the laws.
"""

from __future__ import annotations

from .arming import ARMING_STATE, CHECK_PARAMETERS
from .axis_order import AXIS_ORDER
from .digital_io import LINE_PARAMETERS, LINE_STATE
from .errors import FIGURES
from .faults import EVENT, EVENTS
from .laws.coordinate_transform import DECOUPLING_PARAMETERS, FRAME, MAX_FRAME
from .laws.estimator import ESTIMATOR_STATE, INPUT_HISTORY
from .laws.excitation import EXCITATION_PARAMETERS, EXCITATION_STATE
from .laws.feedforward import HYSTERESIS_PARAMETERS, HYSTERESIS_STATE
from .laws.learned import LEARNED_PARAMETERS, LEARNED_STATE
from .laws.lqg import OUTER_PARAMETERS, OUTER_STATE
from .laws.move import MOVE_PARAMETERS, MOVE_STATE
from .laws.pid import PID_PARAMETERS, PID_STATE
from .laws.reference import REFERENCE_PARAMETERS, REFERENCE_STATE
from .laws.saturation import LIMITER_PARAMETERS
from .laws.sensor import SENSOR_STATE
from .record import MAX_AXES as MAX_AXES
from .record import Record as Record
from .record import record
from .reference_blend import BLEND_STATE
from .states import FAULTS
from .supervisor import SUPERVISOR_STATE
from .watch import WATCH_PARAMETERS, WATCH_STATE

MAX_DRIVERS = 4
MAX_SIGNALS = 48
MAX_OUTPUTS = 8

SIGNAL = record(("value", "f8"), ("time_ns", "i8"), ("sequence", "i8"), ("status", "i8"))
"""One input as a driver leaves it; ``sequence`` grows by one a fresh sample, ``status`` 0 is good."""

AXIS_PARAMETERS = record(
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
    ("awaited_cycles", "f8"),
    ("preview_s", "f8"),
    ("centre_um", "f8"),
    ("setpoint_low_um", "f8"),
    ("setpoint_high_um", "f8"),
    ("setpoint_slew_um", "f8"),
    ("sweep_um", "f8"),
    ("authority", "f8"),
    ("authority_step", "f8"),
    ("blend_decay", "f8"),
    ("feedback", "i8"),
    ("limiter", LIMITER_PARAMETERS),
    ("pid", PID_PARAMETERS),
    ("fallback", PID_PARAMETERS),
    ("watch", WATCH_PARAMETERS),
    ("reference", REFERENCE_PARAMETERS),
    ("learned", LEARNED_PARAMETERS),
    ("decoupling", DECOUPLING_PARAMETERS),
    ("move", MOVE_PARAMETERS),
    ("check", CHECK_PARAMETERS, (2,)),
    ("excitation", EXCITATION_PARAMETERS),
    ("hysteresis", HYSTERESIS_PARAMETERS),
    ("outer", OUTER_PARAMETERS),
)
AXIS_STATE = record(
    ("wanted_cycle", "i8"),
    ("strain_error_um", "f8"),
    ("stage_error_um", "f8"),
    ("path_um", "f8"),
    ("error_fresh", "i8"),
    ("awaited_cycles", "f8"),
    ("preview_s", "f8"),
    ("blend", BLEND_STATE),
    ("supervisor", SUPERVISOR_STATE),
    ("outer", OUTER_STATE),
    ("setpoint_um", "f8"),
    ("request_V", "f8"),
    ("voltage_V", "f8"),
    ("strain", SENSOR_STATE),
    ("stage", SENSOR_STATE),
    ("deviation", SENSOR_STATE),
    ("pid", PID_STATE),
    ("reference", REFERENCE_STATE),
    ("learned", LEARNED_STATE),
    ("added_um", "f8"),
    ("move", MOVE_STATE),
    ("hysteresis", HYSTERESIS_STATE),
    ("estimator", ESTIMATOR_STATE),
    ("setpoints", "f8", (INPUT_HISTORY,)),
    ("references", "f8", (INPUT_HISTORY,)),
    ("amplifier_ok", LINE_STATE),
    ("temperature_ok", LINE_STATE),
    ("excitation", EXCITATION_STATE),
)

CELL_PARAMETERS = record(
    ("version", "i8"),
    ("axes", "i8"),
    ("period_ns", "i8"),
    ("enable_cycles", "i8"),
    ("check_cycles", "i8"),
    ("lift_cycles", "i8"),
    ("lift_turn_cycles", "i8"),
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
    ("part", LINE_PARAMETERS),
    ("tool", LINE_PARAMETERS),
    ("learned_tool", "i8"),
    ("amplifier_enable", "i8"),
    ("feed_hold", "i8"),
    ("heartbeat", "i8"),
    ("heartbeat_cycles", "i8"),
    ("amplifier_reset", "i8"),
    ("reset_cycles", "i8"),
    ("frame", FRAME),
    ("figures_step", "f8"),
    ("trial_cycles", "i8"),
    ("trial_rest", "i8"),
    ("trial_step", "f8"),
    ("trial_factor", "f8"),
    ("trial_floor", "f8"),
    ("axis", AXIS_PARAMETERS, (MAX_AXES,)),
)
CELL_STATE = record(
    ("state", "i8"),
    ("phase", "i8"),
    ("stopping", "i8"),
    ("soft", "i8"),
    ("resumed", "i8"),
    ("checks", "i8", (2,)),
    ("lifts", "i8"),
    ("entered_cycle", "i8"),
    ("cycle", "i8"),
    ("missed", "i8"),
    ("tracking_cycle", "i8"),
    ("reset_until_cycle", "i8"),
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
    ("refused", "i8"),
    ("link_down", "i8"),
    ("outputs_taken", "i8"),
    ("outputs_away", "i8"),
    ("enable", LINE_STATE),
    ("interlock", LINE_STATE),
    ("retracted", LINE_STATE),
    ("part_line", LINE_STATE),
    ("part", "i8"),
    ("parts", "i8"),
    ("part_begun", "i8"),
    ("tool_line", LINE_STATE),
    ("tool", "i8"),
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
    ("order", AXIS_ORDER, (MAX_AXES,)),
    ("axis", AXIS_STATE, (MAX_AXES,)),
    ("watch", WATCH_STATE, (MAX_AXES,)),
    ("figures", FIGURES, (MAX_AXES,)),
    ("arming", ARMING_STATE, (MAX_AXES,)),
    ("event", EVENT, (EVENTS,)),
)

DRIVER = record(
    ("exchange", "i8"),
    ("context", "i8"),
    ("first_input", "i8"),
    ("first_output", "i8"),
)
"""A cyclic driver as the loop calls it: addresses, and where its channels begin in the image."""
