"""Parameters and state of the simulated cell: the context that loop and host share."""

from __future__ import annotations

from typing import Any

import numpy as np

from micromanip.driver import SIGNAL, Compiler

compiled = Compiler(__file__)

MAX_AXES = 3
STACK = 64
CREEP_OPERATORS = 13
CREEP_TIMES_S = np.logspace(-3, 3, CREEP_OPERATORS)
MECHANICAL_STATES = 7
MOST_LATE = 8
"""Periods by which an output may be late on top of its own."""
HARMONICS = 4
"""Of tooth passing that the force may have beside its frequency."""
DEVIATION_SINES = 4
MOST_ROWS = 65_536
"""Of a deviation that is played from a file: a minute at 1 kHz."""
SUBSTEPS = 2
"""Plant steps a loop period."""
CHANNELS = (
    "strain",
    "stage",
    "deviation",
    "acceleration",
    "true_strain",
    "true_stage",
    "path_error",
    "uncompensated",
)
CARRIED = ("strain", "stage", "acceleration")
"""Channels that go by a bus, where there is one; so do all lines."""
CELL_LINES = ("enable", "interlock", "retracted")
AXIS_LINES = ("amplifier_ok", "temperature_ok")
SWITCHES = ("amplifier_enable", "feed_hold", "heartbeat")
MAX_INPUTS = MAX_AXES * (len(CHANNELS) + len(AXIS_LINES)) + len(CELL_LINES)
MAX_OUTPUTS = MAX_AXES + len(SWITCHES)
MAX_FAULTS = 16
IN_FLIGHT = 32
"""Frames that a simulated bus carries at a time, each way."""
FAULT_KINDS = ("value", "offset", "scale", "freeze", "nan", "status", "drop", "thin", "spike", "drift", "error")
EXCHANGE = "exchange"
"""Where a fault of the kind `error` acts: on the exchange as a whole."""


def _record(*fields: tuple[Any, ...]) -> np.dtype[Any]:
    return np.dtype(list(fields), align=True)


PREISACH = _record(("c", "f8"), ("d", "f8"), ("k1", "f8"), ("k2", "f8"), ("reversible", "f8", (3,)))
MEMORY = _record(
    ("extremum_V", "f8", (STACK,)), ("output_um", "f8", (STACK,)), ("depth", "i8"), ("input_V", "f8"), ("merged", "i8")
)
BOUC_WEN = _record(
    ("present", "i8"),
    ("linear", "f8"),
    ("square", "f8"),
    ("fall", "f8"),
    ("with_sign", "f8"),
    ("without_sign", "f8"),
    ("lag_share", "f8"),
    ("lag_step", "f8"),
)
BOUC_WEN_STATE = _record(("input_V", "f8"), ("internal_um", "f8"), ("lagging_um", "f8"))

AXIS_PARAMETERS = _record(
    ("preisach", PREISACH),
    ("bouc_wen", BOUC_WEN),
    ("late", "i8"),
    ("creep_gain", "f8"),
    ("creep_step", "f8", (CREEP_OPERATORS,)),
    ("dac_step_V", "f8"),
    ("low_V", "f8"),
    ("high_V", "f8"),
    ("amplifier_step", "f8"),
    ("slew_V", "f8"),
    ("bleed_step", "f8"),
    ("amplifier_noise_V", "f8"),
    ("a", "f8", (MECHANICAL_STATES, MECHANICAL_STATES)),
    ("b", "f8", (MECHANICAL_STATES, 2)),
    ("rest", "f8", (MECHANICAL_STATES,)),
    ("rocking", "f8"),
    ("lever", "f8"),
    ("stage_acceleration", "f8", (MECHANICAL_STATES + 2,)),
    ("strain_zero_um", "f8"),
    ("strain_noise_um", "f8"),
    ("hum_um", "f8"),
    ("hum_omega", "f8"),
    ("strain_step_um", "f8"),
    ("strain_range_um", "f8"),
    ("stage_zero_um", "f8"),
    ("stage_noise_um", "f8"),
    ("stage_range_um", "f8"),
    ("acceleration_noise", "f8"),
    ("drift_um", "f8"),
    ("drift_step", "f8"),
    ("force_start_s", "f8"),
    ("force_static_N", "f8"),
    ("force_step", "f8"),
    ("tooth_N", "f8"),
    ("tooth_omega", "f8"),
    ("harmonics", "f8", (HARMONICS,)),
    ("force_noise_N", "f8"),
    ("force_noise_decay", "f8"),
    ("deviation_um", "f8", (DEVIATION_SINES,)),
    ("deviation_omega", "f8", (DEVIATION_SINES,)),
    ("deviation_phase", "f8", (DEVIATION_SINES,)),
    ("tracker_periods", "i8"),
    ("tracker_latency_ns", "i8"),
    ("tracker_noise_um", "f8"),
    ("tracker_row", "f8", (MAX_AXES,)),
    ("coupling", "f8", (MAX_AXES,)),
    ("pushed_N_per_um", "f8", (MAX_AXES,)),
)
AXIS_STATE = _record(
    ("memory", MEMORY),
    ("bouc_wen", BOUC_WEN_STATE),
    ("decided_V", "f8", (MOST_LATE,)),
    ("creep_um", "f8", (CREEP_OPERATORS,)),
    ("latched_V", "f8"),
    ("amplifier_V", "f8"),
    ("x", "f8", (MECHANICAL_STATES,)),
    ("free_x", "f8", (MECHANICAL_STATES,)),
    ("force_N", "f8"),
    ("pushed_N", "f8"),
    ("rested_um", "f8"),
    ("engaged", "f8"),
    ("coloured_N", "f8"),
    ("drift_um", "f8"),
    ("tracked", "i8"),
    ("random", "u8", (2,)),
    ("spare", "f8"),
    ("has_spare", "i8"),
)
LINES = _record(
    ("present", "i8"),
    ("first_input", "i8"),
    ("first_output", "i8"),
    ("retract_periods", "i8"),
    ("heartbeat_periods", "i8"),
    ("enable", "f8"),
    ("amplifier_enable", "i8"),
    ("feed_hold", "i8"),
    ("held_periods", "i8"),
    ("heartbeat", "f8"),
    ("silent_periods", "i8"),
    ("tripped", "i8"),
    ("worked_periods", "i8"),
)
"""The digital lines: options, then what they are at. ``heartbeat_periods`` 0 is no watchdog."""
FAULT = _record(
    ("kind", "i8"),
    ("input", "i8"),
    ("value", "f8"),
    ("first_period", "i8"),
    ("end_period", "i8"),
    ("begun", "i8"),
    ("done", "i8"),
    ("sequence", "i8"),
    ("held", SIGNAL),
)
"""A scheduled fault, then what it remembers; ``end_period`` 0 is never."""
SAMPLES_FRAME = _record(
    ("due", "i8"), ("time_ns", "i8"), ("value", "f8", (MAX_INPUTS,)), ("status", "i8", (MAX_INPUTS,))
)
OUTPUTS_FRAME = _record(("due", "i8"), ("value", "f8", (MAX_OUTPUTS,)))
"""What is on its way, and the period in which it arrives."""
BUS = _record(
    ("present", "i8"),
    ("input_Hz", "f8"),
    ("input_periods", "i8"),
    ("output_Hz", "f8"),
    ("output_periods", "i8"),
    ("input_ticks", "i8"),
    ("output_ticks", "i8"),
    ("samples_sent", "i8"),
    ("samples_seen", "i8"),
    ("outputs_sent", "i8"),
    ("outputs_seen", "i8"),
    ("reading", SIGNAL, (MAX_INPUTS,)),
    ("passed", "i8", (MAX_INPUTS,)),
    ("written", "f8", (MAX_OUTPUTS,)),
    ("samples", SAMPLES_FRAME, (IN_FLIGHT,)),
    ("outputs", OUTPUTS_FRAME, (IN_FLIGHT,)),
)
"""A bus between loop and cell: options, ticks so far, the sensors as they are, and what is on its way."""
PATH = _record(("rows", "i8"), ("rows_per_s", "f8"), ("start_s", "f8"), ("um", "f8", (MAX_AXES, MOST_ROWS)))
"""The robot's deviation out of a file; 0 rows: it is the sum of sines."""
CONTEXT = _record(
    ("axes", "i8"),
    ("inputs", "i8"),
    ("outputs", "i8"),
    ("period_ns", "i8"),
    ("periods", "i8"),
    ("opened", "i8"),
    ("safe", "i8"),
    ("pushes", "i8"),
    ("lines", LINES),
    ("bus", BUS),
    ("faults", "i8"),
    ("fault", FAULT, (MAX_FAULTS,)),
    ("p", AXIS_PARAMETERS, (MAX_AXES,)),
    ("s", AXIS_STATE, (MAX_AXES,)),
    ("path", PATH),
)
