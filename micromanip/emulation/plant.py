"""A simulated cyclic driver advanced in real time: the plant that the emulated devices measure and move.

Its periods lie on a grid of CLOCK_MONOTONIC; whatever happens between two instants of the grid is seen at the later
one. A sample carries the plant's own time, so it agrees with what a controller on the same machine takes as now.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.bus.cyclic import EXCHANGE_C, CyclicDriver, call_context
from micromanip.errors import CheckFailed
from micromanip.rt.intrinsics import call_exchange
from micromanip.rt.records import SIGNAL

from .compiled import compiled

PERIOD_NS = 100_000
"""The plant's own period: a stage moves the same, however fast the controller's loop is."""
MOST_PERIODS = 1000
"""A stall longer than this is not made up: the plant has stood still for the rest of it."""
STALL_PERIODS = 100
"""From here on a gap between two events counts as a stall of the machine."""


@dataclass
class Stalls:
    """Gaps between events, in which this process was not scheduled."""

    _late = False
    count: int = 0
    longest_ms: float = 0.0

    def behind(self, late_ns: int) -> None:
        """What happens now should have happened `late_ns` ago: a stall, until that is made up."""
        late_ms = late_ns * 1e-6
        late = late_ns >= STALL_PERIODS * PERIOD_NS
        self.count += late and not self._late
        self._late = late
        if late:
            self.longest_ms = max(self.longest_ms, late_ms)

    def take_report(self) -> dict[str, float]:
        """For a document: those since the last call."""
        report = {"count": self.count, "longest_ms": self.longest_ms}
        self.count, self.longest_ms = 0, 0.0
        return report


class PlantInRealTime:
    """An opened simulated driver: `advance_to` an instant, `read` its inputs, `write` its outputs."""

    def __init__(self, driver: CyclicDriver, period_ns: int = PERIOD_NS) -> None:
        """Opens `driver`, which was built with `period_ns`; its time stands still until `begin`.

        Raises CheckFailed where it does not open.
        """
        functions = driver.functions()
        self._context = driver.context()
        if code := call_context(functions.open, self._context.ctypes.data):
            raise CheckFailed(f"the simulated plant could not be opened: code {code}")
        self.inputs = {name: i for i, name in enumerate(driver.inputs)}
        self.outputs = {name: i for i, name in enumerate(driver.outputs)}
        self.time_ns, self._period_ns = 0, period_ns
        self.stalls = Stalls()
        self._signals = np.zeros(len(self.inputs), SIGNAL)
        self._values: list[float] = [0.0] * len(self.inputs)
        self._outputs = np.zeros(len(self.outputs))
        self._written = False
        self._address = functions.exchange
        self._exchange = EXCHANGE_C(functions.exchange)
        self._at = self._context.ctypes.data, self._outputs.ctypes.data, self._signals.ctypes.data

    def begin(self, now_ns: int) -> None:
        """Time runs from `now_ns` on."""
        self.time_ns = now_ns

    def advance_to(self, now_ns: int) -> None:
        """Let the periods up to `now_ns` pass with the outputs in force, then put in force what was written."""
        periods = max(0, (now_ns - self.time_ns) // self._period_ns)
        if periods >= STALL_PERIODS:
            self._stalled(periods)
        self.time_ns += periods * self._period_ns
        if periods > 0 or self._written:
            self._written = False
            if code := self._exchange(*self._at, self.time_ns, min(periods, MOST_PERIODS)):
                raise CheckFailed(f"the simulated plant failed: code {code}")
            self._values = self._signals["value"].tolist()

    def read(self, channel: str) -> tuple[float, int]:
        """Newest sample of an input: its value, and when it was taken (CLOCK_MONOTONIC, 0 for never)."""
        i = self.inputs[channel]
        return self._values[i], int(self._signals[i]["time_ns"])

    def value(self, channel: str) -> float:
        """Newest value of an input."""
        return self._values[self.inputs[channel]]

    @property
    def addresses(self) -> tuple[int, int]:
        """Where its `exchange` is, and its context: for compiled code that advances it, and then says so (`is_at`)."""
        return self._address, int(self._at[0])

    @property
    def arrays(self) -> tuple[NDArray[np.float64], NDArray[np.void]]:
        """Its outputs and its inputs, as `exchange` takes them."""
        return self._outputs, self._signals

    def is_at(self, time_ns: int) -> None:
        """Somebody else has advanced it."""
        self.time_ns = time_ns
        self._values = self._signals["value"].tolist()

    def samples(self, channel: str) -> int:
        """How often an input has been fresh."""
        return int(self._signals[self.inputs[channel]]["sequence"])

    def write(self, channel: str, value: float) -> None:
        """What an output shall be from the next `advance_to` on."""
        self._outputs[self.outputs[channel]] = value
        self._written = True

    def _stalled(self, periods: int) -> None:
        self.stalls.count += 1
        self.stalls.longest_ms = max(self.stalls.longest_ms, periods * self._period_ns * 1e-6)


PLANT = (("exchange", "i8"), ("context", "i8"), ("period_ns", "i8"), ("most_periods", "i8"), ("time_ns", "i8"))
"""Fields of a device that compiled code serves: where the plant's function and context are, and how far its time has
come."""


def fill_plant(d: Any, plant: PlantInRealTime) -> None:
    """Let compiled code find `plant`."""
    d["exchange"], d["context"] = plant.addresses
    d["period_ns"], d["most_periods"] = PERIOD_NS, MOST_PERIODS


@compiled
def advance(d: Any, now_ns: int, outputs: Any, signals: Any) -> None:
    """Let the plant's periods up to now pass with what was in force, then put in force what is in `outputs`."""
    periods = max(0, (now_ns - d["time_ns"]) // d["period_ns"])
    d["time_ns"] += periods * d["period_ns"]
    passed = min(periods, d["most_periods"])
    call_exchange(d["exchange"], d["context"], outputs.ctypes.data, signals.ctypes.data, d["time_ns"], passed)
