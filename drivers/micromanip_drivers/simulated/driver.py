"""The driver `simulated`: builds the context from the options and hands over the compiled functions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from micromanip.driver import Channel, ConfigError, CyclicDriver, Functions, did_you_mean

from . import options as o
from .axis_context import fill_plant, fill_surroundings
from .lines import make_safe
from .played_path import fill_path
from .records import (
    AXIS_LINES,
    CARRIED,
    CELL_LINES,
    CHANNELS,
    CONTEXT,
    EXCHANGE,
    FAULT_KINDS,
    IN_FLIGHT,
    MAX_AXES,
    PATH,
    SWITCHES,
)

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
