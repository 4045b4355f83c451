"""A plant of a class that the design does not know, simulated, and the truth about it from its own equations.

Generalised plays between saturating ridges (Krasnosel'skii and Pokrovskii) for the hysteresis; creep whose shares grow
by the decade, as a power law's do; three modes, of which the stage sees one in the wrong sense; an amplifier with slew;
delays; a coarse gauge with hum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from micromanip_drivers.simulated.driver import SimulatedCell
from micromanip_drivers.simulated.samples import normal, put
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from micromanip.driver import Channel, Compiler, Functions, entries

from .true_plant import TruePlant

compiled = Compiler(__file__)
Array = NDArray[np.float64]

KERNELS, CREEPS, MODES, SUBSTEPS, MOST_LATE = 16, 6, 3, 2, 4
_STATES = 2 * MODES + 1
CONTEXT = np.dtype(
    [
        *((name, "f8", (KERNELS,)) for name in ("rise_V", "fall_V", "width_V", "weight_um", "play")),
        *((name, "f8") for name in ("linear", "square", "amplifier_step", "slew_V", "low_V", "high_V", "grain_V")),
        *((name, "f8", (CREEPS,)) for name in ("creep_gain", "creep_step", "creep_um")),
        ("a", "f8", (_STATES, _STATES)),
        *((name, "f8", (_STATES,)) for name in ("b", "x", "later_x", "stage_row")),
        *((name, "f8") for name in ("strain_zero", "stage_zero", "strain_noise", "stage_noise", "hum", "step")),
        *((name, "f8") for name in ("period_s", "amplifier_V", "latched_V", "spare")),
        ("decided_V", "f8", (MOST_LATE,)),
        *((name, "i8") for name in ("late", "periods", "opened", "has_spare")),
        ("random", "u8", (2,)),
    ],
    align=True,
)


@dataclass(frozen=True)
class Foreign:
    """Figures of one plant, in V, um, s and Hz; arrays as long as there are kernels, creep operators or modes."""

    rise_V: Array
    fall_V: Array
    width_V: Array
    weight_um: Array
    linear: float
    square: float
    creep: Array
    amplifier_Hz: float
    slew_V_per_ms: float
    modes_Hz: Array
    damping: Array
    on_gauge: Array
    on_stage: Array
    late: int
    bits: int
    hum_um: float
    strain_noise_um: float
    seed: int

    @classmethod
    def drawn(cls, seed: int) -> Foreign:
        """The plant of `seed`; the same seed gives the same. Its stack moves 95 to 150 um over 150 V."""
        rng = np.random.default_rng(seed)
        half_V = 2.0 + 38.0 * rng.uniform(size=KERNELS) ** 1.5
        middle_V = rng.uniform(10.0, 130.0, KERNELS)
        weights = rng.uniform(0.2, 1.0, KERNELS)
        share = rng.uniform(0.3, 0.6)
        reach = rng.uniform(95.0, 150.0)
        lever = rng.uniform(4.0, 6.0)
        first = rng.uniform(38.0, 70.0)
        stage = np.array([1.15, -rng.uniform(0.05, 0.25), 0.0])
        stage[2] = 1.0 - stage.sum()
        gauge = np.array([rng.uniform(0.01, 0.06), rng.uniform(0.005, 0.03), 0.0])
        gauge[2] = 1.0 - gauge.sum()
        return cls(
            middle_V + half_V,
            middle_V - half_V,
            rng.uniform(15.0, 60.0, KERNELS),
            0.5 * share * reach * weights / weights.sum(),
            (1.0 - share) * reach / 150.0,
            rng.uniform(-6e-4, 6e-4),
            0.004 * 1.6 ** np.arange(CREEPS) * rng.uniform(0.5, 1.2),
            rng.uniform(500.0, 1500.0),
            rng.uniform(20.0, 60.0),
            np.array([first, first * rng.uniform(2.6, 4.2), rng.uniform(900.0, 2200.0)]),
            np.array([rng.uniform(0.015, 0.05), rng.uniform(0.01, 0.04), rng.uniform(0.03, 0.1)]),
            gauge,
            lever * stage,
            int(rng.integers(0, MOST_LATE)),
            14 if rng.uniform() < 0.7 else 16,
            rng.uniform(0.02, 0.15),
            rng.uniform(0.03, 0.06),
            seed,
        )

    @property
    def lever(self) -> float:
        """How far the stage goes for a micrometre of the gauge."""
        return float(self.on_stage.sum())

    def continuous(self) -> tuple[Array, Array]:
        """``x' = A x + b free``: position and speed of each mode, then the gauge's reading."""
        a, b = np.zeros((_STATES, _STATES)), np.zeros(_STATES)
        for k, (hertz, damping) in enumerate(zip(self.modes_Hz, self.damping, strict=True)):
            omega = 2.0 * np.pi * hertz
            a[2 * k, 2 * k + 1] = 1.0
            a[2 * k + 1, 2 * k : 2 * k + 2] = -(omega**2), -2.0 * damping * omega
            b[2 * k + 1] = omega**2
        gauge = 2.0 * np.pi * 2500.0
        a[-1, :-1:2], a[-1, -1] = gauge * self.on_gauge, -gauge
        return a, b

    def discrete(self, step_s: float) -> tuple[Array, Array]:
        """The same for a displacement that is held over `step_s`."""
        a, b = self.continuous()
        whole = expm(np.block([[a, b[:, None]], [np.zeros((1, _STATES + 1))]]) * step_s)
        return whole[:_STATES, :_STATES], whole[:_STATES, _STATES]

    def free_um(self, volts: Array) -> Array:
        """Free displacement (n,) for voltages (n,), creep left out, from rest at 0 V."""
        c = self.context(1e-4)[0]
        out = np.zeros(len(volts))
        for k, v in enumerate(volts):
            out[k] = _free(c, v)
        return out

    def context(self, period_s: float) -> NDArray[Any]:
        """The record that is simulated."""
        record = np.zeros(1, CONTEXT)
        c, step_s = record[0], period_s / SUBSTEPS
        for name in ("rise_V", "fall_V", "width_V", "weight_um", "linear", "square", "late"):
            c[name] = getattr(self, name)
        c["amplifier_step"] = -np.expm1(-step_s * 2 * np.pi * self.amplifier_Hz)
        c["slew_V"], c["grain_V"] = self.slew_V_per_ms * 1e3 * step_s, 300.0 / 2**16
        c["low_V"], c["high_V"] = -20.0, 150.0
        c["creep_gain"], c["creep_step"] = self.creep, -np.expm1(-step_s / np.logspace(-2, 3, CREEPS))
        c["a"], c["b"] = self.discrete(step_s)
        c["stage_row"][:-1:2] = self.on_stage
        c["strain_noise"], c["stage_noise"], c["hum"] = self.strain_noise_um, 0.012, self.hum_um
        c["step"], c["period_s"], c["has_spare"] = 360.0 / 2**self.bits, period_s, 0
        c["random"] = np.random.SeedSequence(self.seed).generate_state(2, np.uint64)
        c["play"] = -1.0
        c["strain_zero"] = free = _free(c, 0.0)
        c["x"][:-1:2], c["x"][-1] = free, free
        # in balance: what has crept long ago belongs to where it rests
        c["creep_um"] = self.creep * free
        c["stage_zero"] = self.lever * (free + 66.0)
        return record

    def slopes_um_per_V(
        self, centre_V: float, swing_V: float, range_um: tuple[float, float]
    ) -> tuple[float, float, float]:
        """The plant's slope for a small swing about `centre_V`, right after a turn, and at most along a branch.

        The branch is that of the whole stroke, inside the set-points `range_um`.
        """
        up = np.concatenate([np.linspace(0.0, 150.0, 3001), np.linspace(149.95, 0.0, 3000)])
        moved = self.free_um(up)
        slopes, at_um = np.diff(moved) / np.diff(up), moved[:-1] - moved[0]
        steepest = float(slopes[(at_um > range_um[0]) & (at_um < range_um[1])].max())
        turn = 2.0 * np.pi * np.arange(4000) / 1000.0
        way = np.concatenate([np.linspace(0.0, centre_V, 2000), centre_V + swing_V * np.sin(turn)])
        last = self.free_um(way)[-1000:]
        small = float(2.0 * np.mean((last - last.mean()) * np.sin(turn[-1000:])) / swing_V)
        flattest = self.linear + min(0.0, 2.0 * self.square * 150.0)
        return small, flattest, steepest

    def truth(self, slope_um_per_V: float, period_s: float) -> TruePlant:
        """The plant with its hysteresis replaced by a slope."""
        step_s = period_s / SUBSTEPS
        a, b = self.discrete(step_s)
        follow, size = -np.expm1(-step_s * 2 * np.pi * self.amplifier_Hz), 1 + CREEPS + _STATES
        creep_step = -np.expm1(-step_s / np.logspace(-2, 3, CREEPS))
        step, drive = np.eye(size), np.zeros(size)
        step[0, 0], drive[0] = 1.0 - follow, follow
        pure, fed = slope_um_per_V * step[0], slope_um_per_V * drive[0]
        for k in range(CREEPS):
            step[1 + k] = (1.0 - creep_step[k]) * np.eye(size)[1 + k] + creep_step[k] * self.creep[k] * pure
            drive[1 + k] = creep_step[k] * self.creep[k] * fed
        free = (1.0 - self.creep.sum()) * pure + step[1 : 1 + CREEPS].sum(axis=0)
        free_fed = (1.0 - self.creep.sum()) * fed + drive[1 : 1 + CREEPS].sum()
        step[1 + CREEPS :] = np.outer(b, free)
        step[1 + CREEPS :, 1 + CREEPS :] += a
        drive[1 + CREEPS :] = b * free_fed
        period, driven = np.eye(size), np.zeros(size)
        for _ in range(SUBSTEPS):
            period, driven = step @ period, step @ driven + drive
        late = 1 + self.late
        A = block_diag(period, np.eye(late, k=-1))
        A[:size, -1] = driven
        B, strain, stage = np.zeros(len(A)), np.zeros(len(A)), np.zeros(len(A))
        B[size], strain[size - 1] = 1.0, 1.0
        stage[1 + CREEPS : size - 1 : 2] = self.on_stage
        return TruePlant(A, B, strain, stage, period_s)


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
        pure = _free(c, c["amplifier_V"] + 0.002 * normal(c))
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
    put(inputs[1], stage - c["stage_zero"] + c["stage_noise"] * normal(c), now_ns)
    put(inputs[2], strain, now_ns)
    decided = outputs[0]
    for k in range(c["late"]):
        decided, c["decided_V"][k] = c["decided_V"][k], decided
    inside = max(c["low_V"], min(c["high_V"], decided))
    c["latched_V"] = c["grain_V"] * np.floor(inside / c["grain_V"] + 0.5)
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

    plant: Foreign

    @classmethod
    def of(cls, plant: Foreign, options: Any, period_ns: int) -> ForeignCell:
        """The driver."""
        cell = cls(options, period_ns)
        cell.plant = plant
        return cell

    @property
    def inputs(self) -> tuple[str, ...]:
        return "strain_x", "stage_x", "true_strain_x"

    @property
    def slow_inputs(self) -> tuple[Channel, ...]:
        return ()

    def context(self) -> NDArray[np.uint8]:
        return self.plant.context(self.period_ns * 1e-9).view(np.uint8)

    def functions(self) -> Functions:
        return Functions(*_ENTRIES.addresses)

    def without_process(self) -> ForeignCell:
        return self
