"""A simulated cell in virtual time that is another than configured: causes of its path error are off."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import UsageError
from micromanip.rt.laws.predictor import NEVER_DOUBTED_UM2
from micromanip.rt.states import TRACKING
from micromanip.settings.check import Prepared
from micromanip.settings.schema.model import Configuration

from .cell import Rows, VirtualCell
from .experiment import VirtualExperiment, at_limit, with_options

_WEAK = 0.1
"""What is left of a sensor's noise, 1 % of its power: one that always reads the same is a fault."""
_OF_CELL: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    "tracker noise": {"tracker": {"noise_um": 0.0}},
    "force": {"force": {"static_N": 0.0, "tooth_N": 0.0, "noise_N": 0.0}},
    "force noise": {"force": {"noise_N": 0.0}},
}
_OF_PLANT: Mapping[str, tuple[float, tuple[str, ...]]] = {
    "strain gauge noise": (_WEAK, ("strain_noise_nm", "strain_hum_nm")),
    "capacitive sensor noise": (_WEAK, ("stage_noise_nm",)),
    "amplifier noise": (_WEAK, ("amplifier_noise_mV",)),
    "creep": (0.0, ("creep_per_operator",)),
}
"""What is left of which figures of the plant."""
COUPLING = "coupling"
SWITCHES = (*_OF_CELL, *_OF_PLANT, COUPLING)
"""What can be switched off."""
NOISE = ("tracker noise", "force", "strain gauge noise", "capacitive sensor noise", "amplifier noise")
"""What is drawn, or comes of the process: without it only path and plant are left."""
_AFTER_FORCE_S, _SETTLED_S = 1.0, 2.0
_ENTERED_S = 4.0
"""After which the tool is taken to be in where a driver does not say when it comes."""


@dataclass(frozen=True)
class Played:
    """Path errors (n, axes) in um while the cell tracks, and in which cycles (n, axes) a limit held.

    `trust` (axes,) is that in the narrow predictors at the end.
    """

    error_um: NDArray[np.float64]
    limited: NDArray[np.bool_]
    trust: NDArray[np.float64]

    @property
    def variance_um2(self) -> NDArray[np.float64]:
        """Mean square (axes,) of the path error."""
        return np.asarray(np.mean(self.error_um**2, axis=0))


def simulated_driver(prepared: Prepared) -> str:
    """Name of the simulated driver that moves all axes; UsageError where something else does."""
    configuration = prepared.configuration
    names = {configuration.outputs[f"voltage_{axis}"].driver for axis in configuration.axes}
    kinds = {configuration.drivers[name].driver for name in names}
    if len(names) != 1 or kinds != {"simulated"}:
        raise UsageError(f"only the driver simulated can play another plant; the axes are moved by {sorted(kinds)}")
    return names.pop()


def play_without(
    prepared: Prepared, off: Collection[str], seconds: float, seed: int, noisy: Played | None = None
) -> Played:
    """`seconds` of tracking, machining included, once the tool is in, without the causes `off`.

    Where the tracker's noise is one of them, the predictors are believed as they were in the run `noisy`. Raises
    CheckFailed where the cell does not come to TRACKING or leaves it, UsageError where it is not simulated.
    """
    name = simulated_driver(prepared)
    options: Any = switched(prepared.wiring.options[name], off).model_copy(update={"seed": seed})
    from_s = options.force.start_s + _AFTER_FORCE_S
    trust = noisy.trust if noisy is not None and "tracker noise" in off else None
    return _played(with_options(prepared, name, options), seconds, from_s, trust)


def play_as_it_is(prepared: Prepared, seconds: float) -> Played:
    """`seconds` of tracking, machining included, whichever driver simulates the cell.

    Raises CheckFailed where the cell does not come to TRACKING or leaves it.
    """
    return _played(prepared, seconds, _ENTERED_S)


def trusted(cell: VirtualCell) -> NDArray[np.float64]:
    """Trust (axes,), in nats, in the narrow predictors of `cell`."""
    return np.array(cell.state[0]["axis"]["reference"]["trust"], dtype=float)


def trust(cell: VirtualCell, nats: NDArray[np.float64]) -> None:
    """Let an armed `cell` whose tracker has no noise believe its predictors as one with noise has come to do.

    Which of two is believed is told by the noise that they let through (``rt/laws/predictor.py``): without any it
    would be another cell.
    """
    cell.parameters["axis"]["reference"]["steady_um2"] = NEVER_DOUBTED_UM2
    cell.state["axis"]["reference"]["trust"] = nats


def _played(prepared: Prepared, seconds: float, from_s: float, nats: NDArray[np.float64] | None = None) -> Played:
    """From `from_s` after the start on, or later."""
    configuration = prepared.configuration
    experiment = VirtualExperiment(prepared, process=True)
    cell = experiment.cell(configuration, prepared.samples)
    passed = len(cell.arm()) * configuration.loop.period_ns * 1e-9
    if nats is not None:
        trust(cell, nats)
    cell.run(max(_SETTLED_S, from_s - passed))
    rows = cell.run(seconds)
    experiment.require_no_fault(cell)
    assert (rows["state"] == TRACKING).all()
    error_um = rows["axis"]["path_error_um"][:, : len(configuration.axes)]
    return Played(np.asarray(error_um, dtype=float), at_limits(configuration, rows), trusted(cell))


def at_limits(configuration: Configuration, rows: Rows) -> NDArray[np.bool_]:
    """In which cycles (n, axes) an axis' voltage or set-point is at an end of its range."""
    axes = [(axis, rows["axis"][:, i]) for i, axis in enumerate(configuration.axes)]
    held = [at_limit(configuration, axis, own["voltage_V"], own["setpoint_um"]) for axis, own in axes]
    return np.column_stack(held)


def switched(options: Any, off: Collection[str]) -> Any:
    """Options of the simulated driver without the causes `off`; ValueError for one that is none."""
    unknown = set(off) - set(SWITCHES)
    if unknown:
        raise ValueError(f"nothing to switch off is called {unknown.pop()}")
    change: dict[str, Any] = {
        section: getattr(options, section).model_copy(update=values)
        for cause in off
        for section, values in _OF_CELL.get(cause, {}).items()
    }
    left = {key: share for cause in off if cause in _OF_PLANT for share, keys in [_OF_PLANT[cause]] for key in keys}

    def quiet(plant: Any) -> Any:
        return plant.model_copy(update={key: share * getattr(plant, key) for key, share in left.items()})

    change["plant"] = quiet(options.plant)
    change["variation"] = {name: quiet(plant) for name, plant in options.variation.items()}
    if COUPLING in off:
        change |= {"coupling": 0.0, "couplings": None, "flexure_coupling": 0.0}
    return options.model_copy(update=change)
