"""A plant of a class that the design does not know, simulated, and the truth about it from its own equations.

Generalised plays between saturating ridges (Krasnosel'skii and Pokrovskii) for the hysteresis; creep whose shares grow
by the decade, as a power law's do; three modes, of which the stage sees one in the wrong sense; an amplifier with slew;
delays; a coarse gauge with hum.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from micromanip_drivers.simulated.driver import SimulatedCell
from micromanip_drivers.simulated.samples import normal, put
from numpy.typing import NDArray
from scipy.linalg import expm

from micromanip.driver import Channel, Compiler, Functions, entries

from .true_plant import TruePlant, linearised

compiled = Compiler(__file__)
Array = NDArray[np.float64]

KERNELS, CREEPS, MODES, SUBSTEPS, MOST_LATE = 16, 6, 3, 2, 4
LOW_V, HIGH_V, CENTRE_UM = -20.0, 150.0, 66.0
_STATES = 2 * MODES + 1
_GRAIN_V, _SUPPLY_NOISE_V, _STAGE_NOISE_UM, _GAUGE_HZ = 300.0 / 2**16, 0.002, 0.012, 2500.0
CONTEXT = np.dtype(
    [
        *((name, "f8", (KERNELS,)) for name in ("rise_V", "fall_V", "width_V", "weight_um", "play")),
        *((name, "f8") for name in ("linear", "square", "amplifier_step", "slew_V")),
        *((name, "f8", (CREEPS,)) for name in ("creep_gain", "creep_step", "creep_um")),
        ("a", "f8", (_STATES, _STATES)),
        *((name, "f8", (_STATES,)) for name in ("b", "x", "later_x", "stage_row")),
        *((name, "f8") for name in ("strain_zero", "stage_zero", "strain_noise", "hum", "step")),
        *((name, "f8") for name in ("period_s", "amplifier_V", "latched_V", "spare")),
        ("decided_V", "f8", (MOST_LATE,)),
        *((name, "i8") for name in ("late", "periods", "opened", "has_spare")),
        ("random", "u8", (2,)),
    ],
    align=True,
)


def drawn(seed: int, period_s: float) -> NDArray[Any]:
    """The plant of `seed`, (1,) of `CONTEXT`, at rest at 0 V; its stack moves 95 to 150 um over 150 V."""
    rng, record = np.random.default_rng(seed), np.zeros(1, CONTEXT)
    c, step_s = record[0], period_s / SUBSTEPS
    half_V = 2.0 + 38.0 * rng.uniform(size=KERNELS) ** 1.5
    middle_V = rng.uniform(10.0, 130.0, KERNELS)
    weights, share, reach_um = rng.uniform(0.2, 1.0, KERNELS), rng.uniform(0.3, 0.6), rng.uniform(95.0, 150.0)
    lever, first_Hz = rng.uniform(4.0, 6.0), rng.uniform(38.0, 70.0)
    on_stage = np.array([1.15, -rng.uniform(0.05, 0.25), 0.0])
    on_stage[2] = 1.0 - on_stage.sum()
    on_gauge = np.array([rng.uniform(0.01, 0.06), rng.uniform(0.005, 0.03), 0.0])
    on_gauge[2] = 1.0 - on_gauge.sum()
    c["rise_V"], c["fall_V"], c["play"] = middle_V + half_V, middle_V - half_V, -1.0
    c["width_V"] = rng.uniform(15.0, 60.0, KERNELS)
    c["weight_um"] = 0.5 * share * reach_um * weights / weights.sum()
    c["linear"], c["square"] = (1.0 - share) * reach_um / 150.0, rng.uniform(-6e-4, 6e-4)
    c["creep_gain"] = 0.004 * 1.6 ** np.arange(CREEPS) * rng.uniform(0.5, 1.2)
    c["creep_step"] = -np.expm1(-step_s / np.logspace(-2, 3, CREEPS))
    c["amplifier_step"] = -np.expm1(-step_s * 2 * np.pi * rng.uniform(500.0, 1500.0))
    c["slew_V"] = rng.uniform(20.0, 60.0) * 1e3 * step_s
    modes_Hz = np.array([first_Hz, first_Hz * rng.uniform(2.6, 4.2), rng.uniform(900.0, 2200.0)])
    damping = np.array([rng.uniform(0.015, 0.05), rng.uniform(0.01, 0.04), rng.uniform(0.03, 0.1)])
    c["a"], c["b"] = mechanics(modes_Hz, damping, on_gauge, step_s)
    c["stage_row"][:-1:2], c["period_s"] = lever * on_stage, period_s
    c["late"] = rng.integers(0, MOST_LATE)
    c["step"] = 360.0 / 2 ** (14 if rng.uniform() < 0.7 else 16)
    c["hum"], c["strain_noise"] = rng.uniform(0.02, 0.15), rng.uniform(0.03, 0.06)
    c["random"] = np.random.SeedSequence(seed).generate_state(2, np.uint64)
    c["strain_zero"] = free = _free(c, 0.0)
    c["x"][:-1:2], c["x"][-1] = free, free
    c["creep_um"] = c["creep_gain"] * free  # in balance: what has crept long ago belongs to where it rests
    c["stage_zero"] = lever * (free + CENTRE_UM)
    return record


def mechanics(modes_Hz: Array, damping: Array, on_gauge: Array, step_s: float) -> tuple[Array, Array]:
    """``x+ = a x + b free`` over `step_s`: position and speed of each mode, then the gauge's reading."""
    a, gauge = np.zeros((_STATES + 1, _STATES + 1)), 2.0 * np.pi * _GAUGE_HZ
    for k, omega in enumerate(2.0 * np.pi * modes_Hz):
        a[2 * k, 2 * k + 1] = 1.0
        a[2 * k + 1, 2 * k : 2 * k + 2] = -(omega**2), -2.0 * damping[k] * omega
        a[2 * k + 1, -1] = omega**2  # by the free displacement, which is held
    a[-2, : 2 * MODES : 2], a[-2, -2] = gauge * on_gauge, -gauge
    whole = expm(a * step_s)
    return whole[:_STATES, :_STATES], whole[:_STATES, _STATES]


def free_um(plant: NDArray[Any], volts: Array) -> Array:
    """Free displacement (n,) for voltages (n,), creep left out, from rest at 0 V."""
    c = plant.copy()[0]
    return np.array([_free(c, v) for v in volts])


def slopes_um_per_V(
    plant: NDArray[Any], centre_V: float, swing_V: float, range_um: tuple[float, float]
) -> tuple[float, float, float]:
    """The plant's slope for a small swing about `centre_V`, right after a turn, and at most along a branch.

    The branch is that of the whole stroke, inside the set-points `range_um`.
    """
    c = plant[0]
    up = np.concatenate([np.linspace(0.0, 150.0, 3001), np.linspace(149.95, 0.0, 3000)])
    moved = free_um(plant, up)
    slopes, at_um = np.diff(moved) / np.diff(up), moved[:-1] - moved[0]
    steepest = float(slopes[(at_um > range_um[0]) & (at_um < range_um[1])].max())
    turn = 2.0 * np.pi * np.arange(4000) / 1000.0
    way = np.concatenate([np.linspace(0.0, centre_V, 2000), centre_V + swing_V * np.sin(turn)])
    last = free_um(plant, way)[-1000:]
    small = float(2.0 * np.mean((last - last.mean()) * np.sin(turn[-1000:])) / swing_V)
    return small, float(c["linear"] + min(0.0, 2.0 * c["square"] * 150.0)), steepest


def truth(plant: NDArray[Any], slope_um_per_V: float) -> TruePlant:
    """The plant with its hysteresis replaced by a slope."""
    c, gauge = plant[0], np.zeros(_STATES)
    gauge[-1] = 1.0
    creep, mechanical = (c["creep_gain"], c["creep_step"]), (c["a"], c["b"])
    return linearised(
        slope_um_per_V, c["amplifier_step"], (0.0, 1.0), creep, mechanical, (gauge, c["stage_row"]),
        SUBSTEPS, int(c["late"]), float(c["period_s"]),
    )  # fmt: skip


@compiled
def _free(c: Any, volts: float) -> float:
    """Free displacement (um) at `volts`, after what came before."""
    total = c["linear"] * volts + c["square"] * volts * volts
    for k in range(KERNELS):
        lower = max(-1.0, min(1.0, (volts - c["rise_V"][k]) / c["width_V"][k]))
        upper = max(-1.0, min(1.0, (volts - c["fall_V"][k]) / c["width_V"][k]))
        c["play"][k] = max(lower, min(upper, c["play"][k]))
        total += c["weight_um"][k] * c["play"][k]
    return total


@compiled
def _advance(c: Any) -> None:
    """One period, with the voltage latched."""
    c["periods"] += 1
    y = c["later_x"]
    for _ in range(SUBSTEPS):
        change = (c["latched_V"] - c["amplifier_V"]) * c["amplifier_step"]
        c["amplifier_V"] += max(-c["slew_V"], min(c["slew_V"], change))
        pure = _free(c, c["amplifier_V"] + _SUPPLY_NOISE_V * normal(c))
        free = pure
        for k in range(CREEPS):
            c["creep_um"][k] += c["creep_step"][k] * (c["creep_gain"][k] * pure - c["creep_um"][k])
            free += c["creep_um"][k] - c["creep_gain"][k] * pure
        for i in range(len(y)):
            y[i] = c["b"][i] * free
            for j in range(len(y)):
                y[i] += c["a"][i, j] * c["x"][j]
        for i in range(len(y)):
            c["x"][i] = y[i]


@compiled
def _exchange(c: Any, outputs: Any, inputs: Any, now_ns: int, periods: int) -> int:
    if c["opened"] == 0:
        return 1
    for _ in range(periods):
        _advance(c)
    hum = c["hum"] * np.sin(2.0 * np.pi * 50.0 * c["periods"] * c["period_s"])
    strain = c["x"][len(c["x"]) - 1] - c["strain_zero"] + c["strain_noise"] * normal(c) + hum
    put(inputs[0], c["step"] * np.floor(strain / c["step"] + 0.5), now_ns)
    stage = 0.0
    for i in range(len(c["x"])):
        stage += c["stage_row"][i] * c["x"][i]
    put(inputs[1], stage - c["stage_zero"] + _STAGE_NOISE_UM * normal(c), now_ns)
    put(inputs[2], strain, now_ns)
    decided = outputs[0]
    for k in range(c["late"]):
        decided, c["decided_V"][k] = c["decided_V"][k], decided
    inside = max(LOW_V, min(HIGH_V, decided))
    c["latched_V"] = _GRAIN_V * np.floor(inside / _GRAIN_V + 0.5)
    return 0


@compiled
def _begin(c: Any) -> int:
    c["opened"] = 1
    return 0


@compiled
def _end(c: Any) -> int:
    c["opened"] = 0
    return 0


_ENTRIES = entries(compiled, CONTEXT, _begin, _exchange, _end, _end)


class ForeignCell(SimulatedCell):
    """One axis of such a plant in place of the simulated one's."""

    plant: NDArray[Any]
    inputs = "strain_x", "stage_x", "true_strain_x"
    slow_inputs: tuple[Channel, ...] = ()

    def context(self) -> NDArray[np.uint8]:
        return self.plant.copy().view(np.uint8)

    def functions(self) -> Functions:
        return Functions(*_ENTRIES.addresses)

    def without_process(self) -> ForeignCell:
        return self
