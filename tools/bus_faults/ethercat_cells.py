"""An axis on EtherCAT terminals at 500 Hz, at a rate that a machine which others share keeps: line, ring, drive."""

import os

CELL = """\
schema_version: 2
loop: {rate_hz: 500, cpu: null, spin_us: 10, limits: simulation}
start: {lift_s: 0.2, check_s: null, sweep_s: 0.0, settle_s: 0.0, authority_s: 0.2, ramp_s: 0.2}
drivers:
  cell:
    driver: ethercat
    simulated: true
    interface: INTERFACE
    WAY
    silence_ms: 50
    watchdog: {ms: 300, rest_ms: 250, does: the amplifier ramps to 0 V in 0.2 s}
    cyclic_safe: true
    terminals:
      amplifier:
        vendor: 0x4d4d
        product: 0x1003
        outputs:
          voltages:
            pdo: 0x1600
            fields:
              voltage_x: {index: 0x7000, subindex: 1, type: int32, scale: 1.0e-4, range: [-20, 150]}
              amplifier_enable: {index: 0x7001, subindex: 1, type: uint8, switch: true}
        inputs:
          state: {pdo: 0x1a00, fields: {amplifier_ok_x: {index: 0x6001, subindex: 1, type: uint8}}}
      gauge:
        vendor: 0x4d4d
        product: 0x1004
        inputs:
          strain: {pdo: 0x1a00, fields: {strain_x: {index: 0x6000, subindex: 1, type: int32, scale: 1.0e-4}}}
      capacitive:
        vendor: 0x4d4d
        product: 0x1005
        inputs:
          stage: {pdo: 0x1a00, fields: {stage_x: {index: 0x6000, subindex: 1, type: int32, scale: 1.0e-4}}}
signals:
  strain_x: {driver: cell, max_age_us: 100000, range_um: [-30, 150]}
  amplifier_ok_x: {driver: cell, max_age_us: 1000000}
outputs: {voltage_x: {driver: cell, range_V: [-20, 150], slew_V_per_ms: 2, park_V: 0}}
switches: {amplifier_enable: {driver: cell}}
reference: {source: hold, offset_um: 60}
axes:
  x:
    mode: strain
    centre_um: 66
    setpoint: {range_um: [2, 128], slew_um_per_ms: 0.5}
    inner: {mode: pid, K_V_per_um: 0.05, Ti_ms: 5.0, Td_ms: 0.0, filter_ms: 1.0}
simulation: {seed: 1, axes: [x], lines: {}}
"""
_LOCK = "lock: {time_constant_ms: 100, within_us: 150}"
"""The deadlines are locked to the first terminal's clock."""

_AMPLIFIER = CELL[CELL.index("      amplifier:") : CELL.index("      gauge:")]
_DRIVE = """\
      amplifier:
        vendor: 0x4d4d
        product: 0x1007
        drive:
          mode: csp
          enable: amplifier_enable
          ok: amplifier_ok_x
          reset: amplifier_reset
          enable_ms: 250
          take_up_V_per_s: 400
          codes: {connection_lost: 1, fault_reaction: 2}
        outputs:
          commands:
            pdo: 0x1600
            fields:
              controlword_x: {index: 0x6040, type: uint16}
              mode_x: {index: 0x6060, type: int8}
              voltage_x: {index: 0x607a, type: int32, scale: 1.0e-4, range: [-20, 150]}
        inputs:
          answers:
            pdo: 0x1a00
            fields:
              statusword_x: {index: 0x6041, type: uint16}
              mode_shown_x: {index: 0x6061, type: int8}
              position_x: {index: 0x6064, type: int32, scale: 1.0e-4}
              error_code_x: {index: 0x603f, type: uint16}
"""


def line_cell() -> str:
    """A line."""
    return _cell("l", _LOCK)


def ring_cell() -> str:
    """The same terminals, led back to a second interface."""
    return _cell("r", f"return_interface: ecr{os.getpid()}b\n    {_LOCK}")


def drive_cell() -> str:
    """A drive in place of the amplifier."""
    text = _cell("d", "clocks: true").replace(_AMPLIFIER, _DRIVE)
    text = text.replace("start: {", "start: {enable_s: 0.3, ")
    return text.replace("enable: {driver: cell}}", "enable: {driver: cell}, amplifier_reset: {driver: cell}}")


def _cell(kind: str, way: str) -> str:
    return CELL.replace("INTERFACE", f"ec{kind}{os.getpid()}").replace("WAY", way)
