"""Cells of the watched bench, each on another bus: two axes at rest, slow enough that a jump of a few volts shows.

The devices have no watchdog and keep what they were given last: nothing but the product brings them to rest.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import yaml

from .fault_cells import assembled, free_port
from .oracle import Bounds
from .serial_wire import SerialWire
from .taps import BoardTap, GcsTap, ModbusTap
from .wire import Wire

NO_WATCHDOG_MS = 3.6e6

_BAUD = 1_000_000


@dataclass(frozen=True)
class Cell:
    """The cell on one bus: `driver` names the file of its section; `unit` goes before its channels."""

    driver: str
    unit: str
    tap: Callable
    """Made for each connection: of the arrivals, one who listens."""
    serial: bool
    period_ms: float
    """Of the task that writes the outputs."""
    fine_V: float
    device_V: tuple
    """What the device itself can do."""
    refusal: dict
    """What makes the device refuse what it is asked to do."""

    def text(self, place):
        """Its configuration, its device at `place`: a port, or a path."""
        return assembled("watched", self.driver, place=place, unit=self.unit)

    def place(self, folder):
        """For the device."""
        return folder / "board" if self.serial else free_port()

    def wire(self, place, folder, arrivals):
        """In front of the device at `place`."""
        if self.serial:
            return SerialWire(place, _BAUD, folder / "front", lambda: self.tap(arrivals))
        return Wire(place, lambda: self.tap(arrivals))

    def bounds(self, text):
        """What the outputs may do, read from a configuration with a reader of our own; None where it is not valid."""
        try:
            return self._all_bounds(yaml.safe_load(text)["outputs"])
        except (ValueError, TypeError, KeyError, yaml.YAMLError):
            return None

    def bounds_after(self, bounds, changes):
        """Those after a `set`; None where it would not be valid."""
        outputs = {
            name: {
                "range_V": [each.low_V, each.high_V],
                "slew_V_per_ms": each.step_V / self.period_ms,
                "park_V": each.rest_V,
            }
            for name, each in bounds.items()
        }
        try:
            for key, value in changes.items():
                section, _, rest = key.partition(".")
                if section == "outputs":
                    name, _, what = rest.partition(".")
                    outputs[name][what] = value
            return self._all_bounds(outputs)
        except (ValueError, TypeError, KeyError):
            return None

    def _all_bounds(self, outputs):
        return {name: self._bounds(entry) for name, entry in outputs.items()}

    def _bounds(self, entry):
        low_V, high_V = map(float, entry["range_V"])
        slew, rest_V = float(entry["slew_V_per_ms"]), float(entry["park_V"])
        device_V = self.device_V
        if not (device_V[0] <= low_V <= rest_V <= high_V <= device_V[1] and low_V < high_V and 0.0 < slew < math.inf):
            raise ValueError(entry)
        return Bounds(low_V, high_V, slew * self.period_ms, rest_V, self.fine_V)


CELLS = {
    "gcs": Cell(
        driver="gcs",
        unit="",
        tap=lambda arrivals: GcsTap(arrivals, {"1": "voltage_x", "2": "voltage_y"}),
        serial=False,
        period_ms=10.0,
        fine_V=2e-3,
        device_V=(-20.0, 120.0),
        refusal={"inject": "gcs_error", "driver": "piezo", "code": 5},
    ),
    "modbus": Cell(
        driver="modbus",
        unit="cell.",
        tap=lambda arrivals: ModbusTap(arrivals, {100: ("voltage_x", 0.005), 101: ("voltage_y", 0.005)}),
        serial=False,
        period_ms=10.0,
        fine_V=0.011,
        device_V=(-160.0, 160.0),
        refusal={"inject": "exception", "driver": "piezo", "code": 6},
    ),
    "line": Cell(
        driver="line",
        unit="",
        tap=lambda arrivals: BoardTap(arrivals, {6: ("voltage_x", 0.005), 8: ("voltage_y", 0.005)}),
        serial=True,
        period_ms=10.0,
        fine_V=0.011,
        device_V=(-20.0, 120.0),
        refusal={"inject": "hang", "driver": "piezo"},
    ),
}
"""By the bus between controller and device. A line resolves a step to half a count at either end of it."""
