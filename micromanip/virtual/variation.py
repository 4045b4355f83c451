"""Whole cells in virtual time whose plant differs from the configuration's, as the robustness analysis draws it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.settings.check import Prepared

from .experiment import VirtualExperiment, with_options
from .switched import simulated_driver

SECONDS = 3.0


@dataclass(frozen=True)
class VariedCell:
    """Runs the cell of `prepared`, machining included, with another plant in one axis.

    Calling it with the factors of a perturbation (1 leaves a figure as it is; ``delay_cycles`` is added) and a seed
    of the noise gives ``rms_um`` and ``max_um`` of the error after tracking began: the path error where the
    simulation knows it, reference minus true strain otherwise; ``range_um``, what the error would be at its worst
    without control; and ``stopped``, why the cell did not come to TRACKING or left it, else None.
    """

    prepared: Prepared
    axis: str

    def __call__(self, factors: Mapping[str, float], seed: int) -> dict[str, Any]:
        configuration = self.prepared.configuration
        index = list(configuration.axes).index(self.axis)
        cell = VirtualExperiment(self.varied(factors, seed), process=True).cell(configuration)
        try:
            cell.arm()
        except CheckFailed as problem:
            return {"rms_um": None, "max_um": None, "range_um": None, "stopped": str(problem)}
        rows = cell.run(SECONDS, every=5)
        axis = rows["axis"][:, index]
        error, moved = axis["path_error_um"], axis["uncompensated_um"]
        if not np.isfinite(error).all():
            error, moved = axis["reference_um"] - axis["true_strain_um"], axis["reference_um"]
        if not np.isfinite(error).all():
            error = axis["reference_um"] - axis["strain_um"]
        return {
            "rms_um": float(np.sqrt(np.mean(error**2))),
            "max_um": float(np.abs(error).max()),
            "range_um": float(np.abs(moved).max()),
            "stopped": next((fault.seen for fault in cell.faults()), None),
        }

    def varied(self, factors: Mapping[str, float], seed: int) -> Prepared:
        """The configuration with the plant of this axis changed."""
        name = simulated_driver(self.prepared, [self.axis])
        options: Any = self.prepared.wiring.options[name]
        plant = options.variation.get(self.axis, options.plant)
        period_s = self.prepared.configuration.loop.period_ns * 1e-9
        # the actuation's delay beyond its whole cycles is the amplifier's lag
        lag_s = max(2e-5, 1.0 / (2 * np.pi * plant.amplifier_Hz) + factors["delay_cycles"] * period_s)
        changed = plant.model_copy(
            update={
                "stage_kg": plant.stage_kg * factors["stage_mass"],
                "flexure_N_per_um": plant.flexure_N_per_um * factors["stiffness"],
                "guide_N_per_um": plant.guide_N_per_um * factors["stiffness"],
                "damping": plant.damping * factors["damping"],
                "preisach_c_um_per_V2": plant.preisach_c_um_per_V2 * factors["piezo_gain"] * factors["hysteresis_gain"],
                "reversible_um": tuple(c * factors["piezo_gain"] for c in plant.reversible_um),
                "amplifier_Hz": 1.0 / (2 * np.pi * lag_s),
            }
        )
        variation = {**options.variation, self.axis: changed}
        options = options.model_copy(update={"variation": variation, "seed": seed})
        return with_options(self.prepared, name, options)
