"""The family of plants on which a tuning is tried: none of them is of the class that the design assumes.

A second flexure mode that pushes back on the actuator, stiff and soft coupling, light damping, a hysteresis of another
class, hum, coarse gauges, delays, and every figure +-30 %.
"""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
from micromanip_drivers.simulated.options import BoucWen, Plant, SecondMode

from micromanip.errors import CheckFailed, UsageError
from micromanip.rt.records import MAX_AXES
from micromanip.settings.check import Prepared
from micromanip.settings.schema.reference import File
from micromanip.virtual.experiment import VirtualExperiment, with_options

SPREAD = 0.3
REACH_UM = (90.0, 165.0)
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
