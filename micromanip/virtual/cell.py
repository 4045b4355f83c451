"""A cell in virtual time: same records, same compiled cycle, same driver functions as the loop process."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.bus.cyclic import call_context
from micromanip.errors import CheckFailed
from micromanip.faults import FaultReport, latched
from micromanip.rt.arming import planned_cycles
from micromanip.rt.cycle import run_virtual
from micromanip.rt.records import CELL_STATE, DRIVER, MAX_AXES, MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.rt.states import ARM, NO_COMMAND, READY, TRACKING
from micromanip.rt.telemetry import ROW
from micromanip.settings.check import Prepared
from micromanip.settings.wiring.places import Wiring

Rows = NDArray[Any]
Samples = NDArray[np.float64]

_SENSORS_S = 0.01
"""Until every sensor, the slowest included, has said something."""


class VirtualCell:
    """Opened drivers and loop state, advanced by calls of `run`.

    `parameters` is a (1,) array of CELL_PARAMETERS, `samples` (n, MAX_AXES) what the source `file` plays,
    `axes` the axes' names, for faults.
    Deterministic: the same configuration and seed give the same rows, bit by bit.
    """

    def __init__(
        self, parameters: NDArray[Any], wiring: Wiring, samples: Samples | None = None, axes: Sequence[str] = ()
    ) -> None:
        self.parameters = parameters
        self.state = np.zeros(1, CELL_STATE)
        self.signals = np.zeros(MAX_SIGNALS, SIGNAL)
        self.outputs = np.zeros(MAX_OUTPUTS)
        self.samples = np.zeros((1, MAX_AXES)) if samples is None else samples
        slow = [channel for driver in wiring.drivers.values() for channel in driver.slow_inputs]
        first_s = max((channel.latency_s + 2.0 / channel.rate_hz for channel in slow), default=0.0)
        self._sensors_s = max(_SENSORS_S, first_s)
        self._axes, self._names = list(axes), list(wiring.drivers)
        self._drivers = np.zeros(len(wiring.drivers), DRIVER)
        self._contexts = []
        for record, (name, driver) in zip(self._drivers, wiring.drivers.items(), strict=True):
            context = driver.context()
            functions = driver.functions()
            if call_context(functions.open, context.ctypes.data) != 0:
                raise CheckFailed(f"driver {name} could not be opened")
            record["exchange"], record["context"] = functions.exchange, context.ctypes.data
            record["first_input"], record["first_output"] = wiring.first_input[name], wiring.first_output[name]
            self._contexts.append(context)
        self.state[0]["state"] = READY
        self.state[0]["version"] = parameters[0]["version"]
        for i in range(parameters[0]["axes"]):
            self.state[0]["axis"][i]["voltage_V"] = parameters[0]["axis"][i]["limiter"]["park_V"]

    def run(
        self, seconds: float, every: int = 1, command: int = NO_COMMAND, periods: int = 1, rows: Rows | None = None
    ) -> Rows:
        """Telemetry rows (one in `every` cycles) of the next `seconds`, in `rows` if given; `command` is given first.

        The first cycle comes `periods` after the one before: more than one is a stall of the machine.
        """
        cycles = round(seconds * 1e9 / int(self.parameters[0]["period_ns"]))
        if rows is None:
            rows = np.zeros(cycles // every, ROW)
        run_virtual(
            self.parameters,
            self.state,
            self._drivers,
            self.signals,
            self.outputs,
            self.samples,
            rows,
            cycles,
            every,
            command,
            periods,
        )
        return rows

    def arm(self, every: int = 1) -> Rows:
        """Let the sensors come up, arm, and wait until every axis tracks; that time's rows, one in `every` cycles.

        Raises CheckFailed where a fault, or a sensor, prevents it.
        """
        period_s = int(self.parameters[0]["period_ns"]) * 1e-9
        before = self.run(self._sensors_s, every)
        arming = planned_cycles(self.parameters[0], self.state[0])
        rows = self.run(arming * period_s, every, ARM)
        if self.state[0]["state"] != TRACKING:
            rows = np.concatenate([rows, self.run(period_s, every)])
        if self.state[0]["state"] != TRACKING:
            reason = next((fault.seen for fault in self.faults()), "arming was refused")
            raise CheckFailed(f"the simulated cell did not come to TRACKING: {reason}")
        return np.concatenate([before, rows])

    def faults(self) -> list[FaultReport]:
        """What is latched."""
        return latched(self.state[0], self._axes, self._names)


_BLOCKS, _BLOCK_S = 10, 0.05


def measured_cycle_ns(prepared: Prepared) -> float:
    """Median over some blocks of TRACKING cycles, with the drivers inside, which must be simulated."""
    cell = VirtualCell(prepared.parameters, prepared.wiring, prepared.samples)
    cell.arm()
    cycles = round(_BLOCK_S * 1e9 / prepared.configuration.loop.period_ns)
    taken = []
    for _ in range(_BLOCKS):
        begin = time.perf_counter_ns()
        cell.run(_BLOCK_S, every=10)
        taken.append((time.perf_counter_ns() - begin) / cycles)
    return float(np.median(taken))
