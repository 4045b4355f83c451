"""The family of plants on which a tuning is tried: none of them is of the class that the design assumes.

A second flexure mode that pushes back on the actuator, stiff and soft coupling, light damping, a hysteresis of another
class, hum, coarse gauges, delays, and every figure +-30 %.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Any

import numpy as np
from micromanip_drivers.simulated import mechanics
from micromanip_drivers.simulated.driver import SimulatedCell
from micromanip_drivers.simulated.options import BoucWen, Options, Plant, SecondMode
from micromanip_drivers.simulated.preisach import bouc_wen_step, everett
from micromanip_drivers.simulated.records import CONTEXT, CREEP_OPERATORS, SUBSTEPS

from micromanip.design.experiment import with_axis
from micromanip.errors import CheckFailed, UsageError
from micromanip.rt.records import MAX_AXES
from micromanip.settings.check import Prepared
from micromanip.settings.schema.reference import File
from micromanip.virtual.experiment import VirtualExperiment, with_options

from .true_plant import TruePlant, linearised

SPREAD = 0.3
REACH_UM, MARGIN_UM = (90.0, 165.0), 3.0
"""The working point is at 66 um; the gauge ends at 180."""
_TRIES, _SWEEP_S = 50, 1.0
_DRAWN = (
    *("preisach_c_um_per_V2", "preisach_d_per_V", "preisach_k1", "preisach_k2", "creep_per_operator"),
    *("amplifier_Hz", "amplifier_slew_V_per_ms", "amplifier_noise_mV", "piezo_N_per_um", "actuator_kg"),
    *("flexure_N_per_um", "guide_N_per_um", "stage_kg", "damping"),
)
_BOUC_WEN = ("linear_um_per_V", "square_um_per_V2", "fall_um_per_V", "with_sign_per_V", "without_sign_per_V")
SECOND_HZ, SECOND_STIFFNESS, SECOND_GAIN = (2.5, 4.0), (0.1, 0.4), 0.1
STIFF, SOFT = (2.0, 4.0), (0.3, 0.6)
SWING_V = 1.7
"""Amplitude of the small swing: that of the noise by which actuators are identified."""
HUM_NM, LATE_CYCLES, LIGHTEST = (10.0, 200.0), 3, 0.25


def drawn_plant(seed: int) -> Plant:
    """The plant of `seed`; the same seed gives the same."""
    return _drawn(np.random.default_rng(seed))


def drawn_cell(prepared: Prepared, axis: str, seed: int) -> tuple[Prepared, Plant, float]:
    """The simulated cell with another plant in `axis`, that plant, and how far (um) its output takes it up.

    A plant whose reach is not `REACH_UM` is drawn again, from the same seed on.
    """
    rng = np.random.default_rng(seed)
    for _ in range(_TRIES):
        plant = _drawn(rng)
        drawn = with_plant(prepared, axis, plant, seed)
        with contextlib.suppress(CheckFailed):  # the gauge has come to its end
            reach = reach_um(drawn, axis)
            if REACH_UM[0] <= reach <= REACH_UM[1]:
                return drawn, plant, reach
    raise UsageError(f"none of {_TRIES} plants drawn from seed {seed} reaches {REACH_UM[0]:g} um")


def narrowed(prepared: Prepared, axis: str, reach_um: float, **setpoint: float) -> Prepared:
    """With set-points that this actuator can reach, as an engineer would write them down."""
    known = prepared.configuration.axes[axis].setpoint
    low, high = known.range_um
    update = {"range_um": (low, min(high, reach_um - MARGIN_UM)), **setpoint}
    configuration = with_axis(prepared.configuration, axis, setpoint=known.model_copy(update=update))
    return replace(prepared, configuration=configuration)


def _drawn(rng: np.random.Generator) -> Plant:
    plain = Plant()
    figures: dict[str, Any] = {name: getattr(plain, name) * _factor(rng) for name in _DRAWN}
    reversible = _factor(rng)
    figures["reversible_um"] = tuple(c * reversible for c in plain.reversible_um)
    figures["damping"] *= rng.uniform(LIGHTEST, 1.0)
    coupling = rng.uniform()
    if coupling < 0.5:
        figures["flexure_N_per_um"] *= rng.uniform(*(STIFF if coupling < 0.25 else SOFT))
    if rng.uniform() < 0.6:
        figures["second_mode"] = SecondMode(
            ratio=rng.uniform(*SECOND_HZ),
            stiffness_share=float(np.exp(rng.uniform(*np.log(SECOND_STIFFNESS)))),
            gain=rng.choice([-1.0, 1.0]) * SECOND_GAIN,
        )
    if rng.uniform() < 0.35:
        figures["bouc_wen"] = BoucWen(**{name: getattr(BoucWen(), name) * _factor(rng) for name in _BOUC_WEN})
    figures["strain_hum_nm"] = rng.uniform(*HUM_NM)
    figures["strain_bits"] = 14 if rng.uniform() < 0.5 else 16
    figures["late_cycles"] = int(rng.integers(0, LATE_CYCLES + 1))
    return Plant(**figures)


def _factor(rng: np.random.Generator) -> float:
    return float(rng.uniform(1.0 - SPREAD, 1.0 + SPREAD))


def with_plant(prepared: Prepared, axis: str, plant: Plant, seed: int) -> Prepared:
    """The cell with `plant` in `axis` and noise of `seed`."""
    name = prepared.configuration.outputs[f"voltage_{axis}"].driver
    options: Any = prepared.wiring.options[name]
    drawn = options.model_copy(update={"variation": options.variation | {axis: plant}, "seed": seed})
    return with_options(prepared, name, drawn)


def reach_um(prepared: Prepared, axis: str) -> float:
    """Highest strain (um) that the output's whole range gives, in open loop."""
    configuration, names = prepared.configuration, list(prepared.configuration.axes)
    output, count = configuration.outputs[f"voltage_{axis}"], round(_SWEEP_S * configuration.loop.rate_hz)
    samples = np.zeros((count, MAX_AXES))
    rise = np.minimum(1.0, np.arange(count) / (0.8 * count))
    samples[:, names.index(axis)] = output.park_V + rise * (output.range_V[1] - output.park_V)
    axes = {name: settings.model_copy(update={"mode": "voltage"}) for name, settings in configuration.axes.items()}
    played = configuration.model_copy(update={"axes": axes, "reference": File(source="file", path="(sweep)")})
    rows = VirtualExperiment(prepared)(played, _SWEEP_S, samples, every=100)
    return float(rows["axis"]["strain_um"][-10:, names.index(axis)].mean())


def small_slope(plant: Plant, centre_V: float, swing_V: float = SWING_V) -> float:
    """Free displacement per volt (um/V) of a small sine about `centre_V`, creep and lag left out."""
    record = SimulatedCell(Options(axes=("x",), plant=plant), 100_000).context().view(CONTEXT)[0]
    if plant.bouc_wen is not None:
        p, s = record["p"][0]["bouc_wen"], record["s"][0]["bouc_wen"]
        p["lag_share"], s["input_V"] = 0.0, centre_V
        turn = 2.0 * np.pi * np.arange(4000) / 1000.0
        moved = np.array([bouc_wen_step(p, s, v) for v in centre_V + swing_V * np.sin(turn)])[-1000:]
        return float(2.0 * np.mean(moved * np.sin(turn[-1000:])) / swing_V)
    r = plant.reversible_um
    loop = everett(record["p"][0]["preisach"], centre_V + swing_V, centre_V - swing_V) / (2.0 * swing_V)
    return float(loop + r[0] + 2.0 * r[1] * centre_V + 3.0 * r[2] * centre_V**2)


def true_plant(plant: Plant, slope_um_per_V: float, period_s: float) -> TruePlant:
    """The plant with its hysteresis replaced by a slope."""
    step_s = period_s / SUBSTEPS
    a, b = mechanics.discrete(plant, step_s)
    gains = np.full(CREEP_OPERATORS, plant.creep_per_operator)
    bouc_wen = plant.bouc_wen
    lag = (bouc_wen.lag_share, -np.expm1(-step_s / (1e-3 * bouc_wen.lag_ms))) if bouc_wen else (0.0, 1.0)
    strain, stage = np.zeros(len(a)), np.zeros(len(a))
    strain[4] = stage[2] = 1.0
    if plant.second_mode is not None:
        stage[5], stage[0] = plant.second_mode.gain, -plant.second_mode.gain * plant.lever
    return linearised(
        slope_um_per_V,
        -np.expm1(-step_s * 2 * np.pi * plant.amplifier_Hz),
        lag,
        (gains, -np.expm1(-step_s / np.logspace(-3, 3, CREEP_OPERATORS))),
        (a, b[:, 0]),
        (strain, stage),
        SUBSTEPS,
        plant.late_cycles,
        period_s,
    )
