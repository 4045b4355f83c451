"""What the context holds of one axis, out of the options: per cycle or sub-step, as the compiled functions take it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import mechanics
from .options import Options, Plant
from .records import CREEP_TIMES_S, MECHANICAL_STATES, SUBSTEPS

_JOINT_SPREAD = (1.0, 0.97, 1.03)
_PATH_HZ = (0.11, 0.29, 0.83)
"""Of the robot's slow path error."""
_DAC_SPAN_V, _DAC_BITS = 300.0, 16
_DRIFT_UM_PER_K, _DRIFT_TIME_S = 0.5, 600.0
_BLEED_S = 0.02
"""Time constant of a disabled amplifier."""
_FORCE_NOISE_HZ = 30.0
"""Bandwidth of the machining force's coloured noise."""


def fill_plant(p: Any, plant: Plant, period_ns: int) -> None:
    """Actuator, mechanics, amplifier and sensors."""
    step_s = period_ns * 1e-9 / SUBSTEPS
    preisach = p["preisach"]
    preisach["c"], preisach["d"] = plant.preisach_c_um_per_V2, plant.preisach_d_per_V
    preisach["k1"], preisach["k2"] = plant.preisach_k1, plant.preisach_k2
    preisach["reversible"] = plant.reversible_um
    if plant.bouc_wen is not None:
        other = plant.bouc_wen
        p["bouc_wen"]["present"], p["bouc_wen"]["lag_share"] = 1, other.lag_share
        p["bouc_wen"]["linear"], p["bouc_wen"]["square"] = other.linear_um_per_V, other.square_um_per_V2
        p["bouc_wen"]["fall"] = other.fall_um_per_V
        p["bouc_wen"]["with_sign"], p["bouc_wen"]["without_sign"] = other.with_sign_per_V, other.without_sign_per_V
        p["bouc_wen"]["lag_step"] = -np.expm1(-step_s / (other.lag_ms * 1e-3))
    p["late"] = plant.late_cycles
    p["rocking"] = plant.second_mode.gain if plant.second_mode else 0.0
    p["lever"] = plant.lever
    p["creep_gain"] = plant.creep_per_operator
    p["creep_step"] = -np.expm1(-step_s / CREEP_TIMES_S)
    p["dac_step_V"] = _DAC_SPAN_V / 2**_DAC_BITS
    p["low_V"], p["high_V"] = plant.amplifier_range_V
    p["amplifier_step"] = -np.expm1(-step_s * 2 * np.pi * plant.amplifier_Hz)
    p["bleed_step"] = -np.expm1(-step_s / _BLEED_S)
    p["slew_V"] = plant.amplifier_slew_V_per_ms * 1e3 * step_s
    p["amplifier_noise_V"] = plant.amplifier_noise_mV * 1e-3
    moved, driven = mechanics.discrete(plant, step_s)
    size = len(moved)
    p["a"][:size, :size], p["b"][:size] = moved, driven
    p["rest"][:size] = mechanics.rest(plant)
    a, b = mechanics.continuous(plant)
    row = np.zeros(MECHANICAL_STATES + 2)
    row[: len(a)], row[MECHANICAL_STATES:] = a[3], b[3]
    p["stage_acceleration"] = 1e-6 * row
    p["strain_noise_um"], p["hum_um"] = plant.strain_noise_nm * 1e-3, plant.strain_hum_nm * 1e-3
    p["hum_omega"] = 2 * np.pi * 50.0
    p["strain_range_um"] = plant.strain_range_um
    p["strain_step_um"] = 2 * plant.strain_range_um / 2**plant.strain_bits
    p["stage_zero_um"], p["stage_range_um"] = plant.stage_zero_um, plant.stage_range_um
    p["stage_noise_um"], p["acceleration_noise"] = plant.stage_noise_nm * 1e-3, plant.acceleration_noise
    p["drift_um"] = _DRIFT_UM_PER_K * plant.ambient_step_K
    p["drift_step"] = -np.expm1(-period_ns * 1e-9 / _DRIFT_TIME_S)


def fill_surroundings(p: Any, options: Options, i: int, period_ns: int) -> None:
    """Force, path, tracker, and what the axis with the number `i` has of the others."""
    period_s = period_ns * 1e-9
    force, path, tracker = options.force, options.deviation, options.tracker
    p["force_start_s"], p["force_static_N"] = force.start_s, force.static_N
    p["force_step"] = -np.expm1(-period_s / (force.rise_ms * 1e-3))
    p["tooth_N"], p["tooth_omega"] = force.tooth_N, 2 * np.pi * force.tooth_Hz
    p["harmonics"][: len(force.harmonics)] = force.harmonics
    p["force_noise_N"] = force.noise_N
    p["force_noise_decay"] = np.exp(-period_s * 2 * np.pi * _FORCE_NOISE_HZ)
    p["deviation_um"] = (*path.amplitudes_um, path.joint_um)
    p["deviation_omega"] = 2 * np.pi * np.array([*_PATH_HZ, path.joint_Hz * _JOINT_SPREAD[i]])
    p["deviation_phase"] = np.array([0.0, 1.1, 2.3, 0.7]) * i
    p["tracker_periods"] = max(1, round(1.0 / (tracker.rate_Hz * period_s)))
    p["tracker_latency_ns"] = round(tracker.latency_ms * 1e6)
    p["tracker_noise_um"] = tracker.noise_um
    count = len(options.axes)
    p["tracker_row"][:count] = np.eye(count)[i] if tracker.coordinates is None else tracker.coordinates[i]
    if options.couplings is None:
        p["coupling"][:count] = _round(options.coupling, i, count)
        p["coupling"][i] = 1.0
    else:
        p["coupling"][:count] = options.couplings[i]
    plant = options.variation.get(options.axes[i], options.plant)
    shares = _round(options.flexure_coupling, i, count)
    p["pushed_N_per_um"][:count] = shares / mechanics.compliance(plant)


def _round(share: float, i: int, count: int) -> NDArray[np.float64]:
    """What axis `i` of `count` sees of each: `share` of the next one, and 2/3 of it of the one after; 0 of its own."""
    shares = np.zeros(count)
    if count > 1:
        shares[(i + 1) % count] = share
    if count > 2:
        shares[(i + 2) % count] = share * 2.0 / 3.0
    return shares
