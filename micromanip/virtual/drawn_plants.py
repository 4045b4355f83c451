"""Whole plants drawn at random about the nominal one: hysteresis, creep, mechanics and amplifier, not the sensors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from micromanip.errors import UsageError
from micromanip.rt.records import MAX_AXES
from micromanip.settings.check import Prepared
from micromanip.settings.schema.reference import File

from .experiment import VirtualExperiment

SPREAD = 0.3
LEAST_REACH_UM = 102.0
"""The paper's sine goes up to 100 um."""
_TRIES = 50
_SWEEP_S = 1.0
_DRAWN = (
    *("preisach_c_um_per_V2", "preisach_d_per_V", "preisach_k1", "preisach_k2", "creep_per_operator"),
    *("amplifier_Hz", "amplifier_slew_V_per_ms", "amplifier_noise_mV", "piezo_N_per_um", "actuator_kg"),
    *("flexure_N_per_um", "guide_N_per_um", "stage_kg", "damping"),
)


def drawn_cell(prepared: Prepared, axis: str, seed: int) -> tuple[Prepared, dict[str, float], float]:
    """The simulated cell with another plant in `axis`, its factors, and how far (um) its output takes it up.

    Each figure is multiplied by 0.7 .. 1.3. A plant that can't reach 100 um is drawn again, from the same seed on.
    """
    rng = np.random.default_rng(seed)
    for _ in range(_TRIES):
        factors = {name: float(factor) for name, factor in zip((*_DRAWN, "reversible_um"), _factors(rng), strict=True)}
        drawn = _with_plant(prepared, axis, factors, seed)
        reach = reach_um(drawn, axis)
        if reach >= LEAST_REACH_UM:
            return drawn, factors, reach
    raise UsageError(f"none of {_TRIES} plants drawn from seed {seed} reaches {LEAST_REACH_UM:g} um")


def _factors(rng: np.random.Generator) -> Any:
    return rng.uniform(1.0 - SPREAD, 1.0 + SPREAD, len(_DRAWN) + 1)


def _with_plant(prepared: Prepared, axis: str, factors: dict[str, float], seed: int) -> Prepared:
    configuration, wiring = prepared.configuration, prepared.wiring
    name = configuration.outputs[f"voltage_{axis}"].driver
    options: Any = wiring.options[name]
    plant = options.variation.get(axis, options.plant)
    changed = {key: getattr(plant, key) * factors[key] for key in _DRAWN}
    changed["reversible_um"] = tuple(c * factors["reversible_um"] for c in plant.reversible_um)
    variation = options.variation | {axis: plant.model_copy(update=changed)}
    drawn = options.model_copy(update={"variation": variation, "seed": seed})
    driver = type(wiring.drivers[name])(drawn, configuration.loop.period_ns)
    return replace(prepared, wiring=replace(wiring, drivers=wiring.drivers | {name: driver}))


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
