"""The driver `simulated`: builds the context from the options and hands over the compiled functions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from micromanip.driver import Channel, ConfigError, CyclicDriver, Functions, did_you_mean

from . import mechanics
from . import options as o
from .lines import make_safe
from .options import Options, Plant
from .played_path import fill_path
from .records import (
    AXIS_LINES,
    CARRIED,
    CELL_LINES,
    CHANNELS,
    CONTEXT,
    CREEP_TIMES_S,
    EXCHANGE,
    FAULT_KINDS,
    IN_FLIGHT,
    MAX_AXES,
    MECHANICAL_STATES,
    PATH,
    SUBSTEPS,
    SWITCHES,
)

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


_MOST_COUPLED = 0.5


class SimulatedCell(CyclicDriver):
    """Up to three axes with Preisach hysteresis, creep, flexure, sensors, machining force and tracker."""

    Options: ClassVar[type[BaseModel]] = o.Options
    simulated: ClassVar[bool] = True
    watchdog: ClassVar[str | None] = "none needed: nothing real moves"

    def __init__(self, options: o.Options, period_ns: int) -> None:
        self.options = options
        self.period_ns = period_ns
        for name in options.variation:
            if name not in options.axes:
                raise ConfigError(f"variation.{name}: there is no axis {name}; axes are {', '.join(options.axes)}")
        self._check_bus()
        self._path = np.zeros(1, PATH)[0]
        fill_path(self._path, options.deviation, options.axes)
        rows = options.tracker.coordinates
        if rows is not None and [len(row) for row in rows] != [len(options.axes)] * len(options.axes):
            raise ConfigError(f"tracker.coordinates: a row and a column per axis, {len(options.axes)} of each")
        self._check_couplings()
        for k, fault in enumerate(options.faults):
            if fault.channel not in (*self.inputs, EXCHANGE):
                raise ConfigError(f"faults[{k}].channel: {self._unknown(fault.channel)}")

    @property
    def device(self) -> str | None:
        device: str | None = self.options.device
        return device

    @property
    def inputs(self) -> tuple[str, ...]:
        sensors = tuple(f"{channel}_{axis}" for axis in self.options.axes for channel in CHANNELS)
        return sensors + self._lines if self.options.lines else sensors

    @property
    def _lines(self) -> tuple[str, ...]:
        return (*CELL_LINES, *(f"{line}_{axis}" for line in AXIS_LINES for axis in self.options.axes))

    @property
    def outputs(self) -> tuple[str, ...]:
        voltages = tuple(f"voltage_{axis}" for axis in self.options.axes)
        return voltages + SWITCHES if self.options.lines else voltages

    @property
    def slow_inputs(self) -> tuple[Channel, ...]:
        bus, tracker, axes = self.options.bus, self.options.tracker, self.options.axes
        tracked = tuple(Channel(f"deviation_{axis}", tracker.rate_Hz, tracker.latency_ms * 1e-3) for axis in axes)
        if bus is None:
            return tracked
        carried = [f"{kind}_{axis}" for axis in axes for kind in CARRIED] + list(
            self._lines if self.options.lines else ()
        )
        return (*tracked, *(Channel(name, bus.input_rate_Hz, bus.input_latency_us * 1e-6) for name in carried))

    @property
    def slow_outputs(self) -> tuple[Channel, ...]:
        bus = self.options.bus
        if bus is None:
            return ()
        return tuple(Channel(name, bus.output_rate_Hz, bus.output_latency_us * 1e-6) for name in self.outputs)

    def context(self) -> NDArray[np.uint8]:
        record = np.zeros(1, CONTEXT)
        c = record[0]
        c["axes"], c["period_ns"] = len(self.options.axes), self.period_ns
        c["inputs"], c["outputs"] = len(self.inputs), len(self.outputs)
        seeds = np.random.SeedSequence(self.options.seed).generate_state(2 * MAX_AXES, np.uint64)
        for i, name in enumerate(self.options.axes):
            plant = self.options.variation.get(name, self.options.plant)
            fill_plant(c["p"][i], plant, self.period_ns)
            fill_surroundings(c["p"][i], self.options, i, self.period_ns)
            c["s"][i]["random"] = seeds[2 * i : 2 * i + 2]
        c["pushes"] = int(np.any(c["p"]["pushed_N_per_um"]))
        self._fill_lines(c)
        self._fill_bus(c["bus"])
        if self._path["rows"] > 0:  # else its pages stay untouched
            c["path"] = self._path
        self._fill_faults(c)
        return record.view(np.uint8)

    def without_process(self) -> SimulatedCell:
        idle = self.options.force.model_copy(update={"static_N": 0.0, "tooth_N": 0.0, "noise_N": 0.0})
        return SimulatedCell(self.options.model_copy(update={"force": idle}), self.period_ns)

    def functions(self) -> Functions:
        from . import cell  # compiled or loaded only where it is going to be called

        return Functions(*cell.ENTRIES.addresses)

    def safe_in_host(self) -> Callable[[NDArray[np.uint8]], int]:
        return lambda context: make_safe(context.view(CONTEXT)[0])

    def _unknown(self, channel: str) -> str:
        """What to say of a channel that is none of the inputs."""
        if channel in self._lines:
            return f"{channel} exists with the option lines only: add lines: {{}}"
        return f"there is no channel {channel}; {did_you_mean(channel, self.inputs)}"

    def _periods(self, seconds: float) -> int:
        return max(1, round(seconds * 1e9 / self.period_ns))

    def _fill_lines(self, c: Any) -> None:
        lines, axes = self.options.lines, len(self.options.axes)
        if lines is None:
            return
        line = c["lines"]
        line["present"], line["first_input"], line["first_output"] = 1, axes * len(CHANNELS), axes
        line["retract_periods"] = self._periods(lines.retract_s)
        if lines.heartbeat_ms is not None:
            line["heartbeat_periods"] = self._periods(lines.heartbeat_ms * 1e-3)

    def _check_couplings(self) -> None:
        rows, count = self.options.couplings, len(self.options.axes)
        if rows is None:
            return
        if [len(row) for row in rows] != [count] * count:
            raise ConfigError(f"couplings: a row and a column per axis, {count} of each")
        for i, row in enumerate(rows):
            if row[i] != 1.0:
                raise ConfigError(f"couplings: axis {self.options.axes[i]} sees 1 of its own motion, not {row[i]:g}")
            if sum(abs(share) for share in row) - 1.0 > _MOST_COUPLED:
                raise ConfigError(
                    f"couplings: axis {self.options.axes[i]} sees more than {_MOST_COUPLED:g} of the others' motion: "
                    "that is no stage whose axes are controlled one by one"
                )

    def _check_bus(self) -> None:
        if self.options.bus is None:
            return
        for way in ("input", "output"):
            rate_Hz, latency_us = (
                getattr(self.options.bus, f"{way}_rate_Hz"),
                getattr(self.options.bus, f"{way}_latency_us"),
            )
            if rate_Hz * self.period_ns > 1.000001e9:
                raise ConfigError(f"bus.{way}_rate_Hz: {rate_Hz:g} is more than the loop's {1e9 / self.period_ns:g} Hz")
            if rate_Hz * latency_us * 1e-6 > IN_FLIGHT - 2:
                raise ConfigError(
                    f"bus.{way}_latency_us: {latency_us:g} us at {rate_Hz:g} Hz are "
                    f"{rate_Hz * latency_us * 1e-6:.0f} frames on their way; at most {IN_FLIGHT - 2}"
                )

    def _fill_bus(self, b: Any) -> None:
        bus = self.options.bus
        if bus is None:
            return
        b["present"], b["input_Hz"], b["output_Hz"] = 1, bus.input_rate_Hz, bus.output_rate_Hz
        b["input_periods"] = np.ceil(bus.input_latency_us * 1e3 / self.period_ns - 1e-6)
        b["output_periods"] = np.ceil(bus.output_latency_us * 1e3 / self.period_ns - 1e-6)

    def _fill_faults(self, c: Any) -> None:
        c["faults"] = len(self.options.faults)
        for record, fault in zip(c["fault"], self.options.faults, strict=False):
            record["kind"], record["value"] = FAULT_KINDS.index(fault.kind), fault.value
            record["input"] = -1 if fault.channel == EXCHANGE else self.inputs.index(fault.channel)
            record["first_period"] = round(fault.at_s * 1e9 / self.period_ns)
            if fault.for_s is not None:
                record["end_period"] = record["first_period"] + self._periods(fault.for_s)
