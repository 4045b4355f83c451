"""Cells for the campaign, each on another bus: two axes at rest, slow enough that a jump of a few volts shows.

The devices have no watchdog and keep what they were given last: nothing but the product brings them to rest.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import yaml

from tools.bus_faults.cells import free_port

from .referee import Bounds
from .serial_wire import SerialWire
from .taps import BoardTap, GcsTap, ModbusTap
from .wire import Wire

NO_WATCHDOG_MS = 3.6e6

_CELL = """\
schema_version: 2
loop: {{rate_hz: 250, cpu: null, spin_us: 0, limits: simulation}}
start:
  {{enable_s: 0.0, lift_s: 0.15, check_s: null, sweep_s: 0.0, settle_s: 0.0, authority_s: 0.1, ramp_s: 0.3}}
drivers:
{driver}
signals:
  strain_x: {{driver: piezo, channel: {unit}strain_x, max_age_us: 100000, range_um: [-30, 150]}}
  strain_y: {{driver: piezo, channel: {unit}strain_y, max_age_us: 100000, range_um: [-30, 150]}}
outputs:
  voltage_x: {{driver: piezo, channel: {unit}voltage_x, range_V: [-20, 100], slew_V_per_ms: 0.5, park_V: 0}}
  voltage_y: {{driver: piezo, channel: {unit}voltage_y, range_V: [-20, 100], slew_V_per_ms: 0.5, park_V: 0}}
reference: {{source: jog, offset_um: 60, range_um: [20, 110]}}
axes:
  x:
    mode: strain
    centre_um: 66
    setpoint: {{range_um: [2, 128], slew_um_per_ms: 0.5}}
    inner: {{mode: pid, K_V_per_um: 0.08, Ti_ms: 5.0, Td_ms: 0.0, filter_ms: 1.0}}
  y:
    mode: strain
    centre_um: 66
    setpoint: {{range_um: [2, 128], slew_um_per_ms: 0.5}}
    inner: {{mode: pid, K_V_per_um: 0.08, Ti_ms: 5.0, Td_ms: 0.0, filter_ms: 1.0}}
simulation: {{seed: 1, axes: [x, y], lines: {{}}}}
"""
_GCS = """\
  piezo:
    driver: line
    simulated: true
    tcp: {{host: 127.0.0.1, port: {place}}}
    silence_ms: 200
    watchdog: it has none, and stays at what it was given last
    ascii:
      preset: gcs
      reply_ms: 50
      turnaround_us: 300
      read:
        strains:
          {{command: "POS?", rate_hz: 100, fields: {{strain_x: {{item: "1"}}, strain_y: {{item: "2"}}}}}}
      write:
        x:
          command: SVA
          rate_hz: 100
          cyclic_safe: true
          fields: {{voltage_x: {{item: "1", range: [-20, 120], decimals: 4}}}}
        y:
          command: SVA
          rate_hz: 100
          cyclic_safe: true
          fields: {{voltage_y: {{item: "2", range: [-20, 120], decimals: 4}}}}
"""
_MODBUS = """\
  piezo:
    driver: modbus
    simulated: true
    tcp: {{host: 127.0.0.1, port: {place}}}
    timeout_ms: 50
    response_ms: 1
    watchdog: it has none, and stays at what it was given last
    units:
      cell:
        unit_id: 1
        address_base: 0
        byte_order: big
        word_order: big
        tasks:
          exchange:
            function: 23
            rate_hz: 100
            read:
              strain_x: {{address: 0, type: int32, scale: 1.0e-4}}
              strain_y: {{address: 2, type: int32, scale: 1.0e-4}}
            write:
              voltage_x: {{address: 100, type: int16, scale: 0.005, cyclic_safe: true}}
              voltage_y: {{address: 101, type: int16, scale: 0.005, cyclic_safe: true}}
"""
_BAUD = 1_000_000
_BOARD = """\
  piezo:
    driver: line
    simulated: true
    serial: {{device: {place}, baud: 1000000}}
    silence_ms: 200
    watchdog: it has none, and stays at what it was given last
    binary:
      sync: aa 55
      length: {{at: 2, type: uint8, plus: 6}}
      kind: {{at: 3, type: uint8}}
      crc: {{name: crc16.ibm_3740, byte_order: big, first: 2}}
      receive:
        sensors:
          kind: 0x10
          rate_hz: 100
          counter: {{at: 4, type: uint16, byte_order: little}}
          fields:
            strain_x: {{at: 6, type: int32, byte_order: little, scale: 1.0e-4}}
            strain_y: {{at: 10, type: int32, byte_order: little, scale: 1.0e-4}}
      send:
        voltages:
          kind: 0x20
          rate_hz: 100
          cyclic_safe: true
          counter: {{at: 4, type: uint16, byte_order: little}}
          fields:
            voltage_x: {{at: 6, type: int16, byte_order: little, scale: 0.005, range: [-20, 120]}}
            voltage_y: {{at: 8, type: int16, byte_order: little, scale: 0.005, range: [-20, 120]}}
"""


@dataclass(frozen=True)
class Cell:
    """The cell on one bus: `driver` is its section, to be completed by a place; `unit` goes before its channels."""

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
        return _CELL.format(driver=self.driver.format(place=place).rstrip("\n"), unit=self.unit)

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
        driver=_GCS,
        unit="",
        tap=lambda arrivals: GcsTap(arrivals, {"1": "voltage_x", "2": "voltage_y"}),
        serial=False,
        period_ms=10.0,
        fine_V=2e-3,
        device_V=(-20.0, 120.0),
        refusal={"inject": "gcs_error", "driver": "piezo", "code": 5},
    ),
    "modbus": Cell(
        driver=_MODBUS,
        unit="cell.",
        tap=lambda arrivals: ModbusTap(arrivals, {100: ("voltage_x", 0.005), 101: ("voltage_y", 0.005)}),
        serial=False,
        period_ms=10.0,
        fine_V=0.011,
        device_V=(-160.0, 160.0),
        refusal={"inject": "exception", "driver": "piezo", "code": 6},
    ),
    "serial": Cell(
        driver=_BOARD,
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
