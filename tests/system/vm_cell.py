"""The configuration of the scenarios in a virtual machine: slow enough for an emulated processor."""

import sys
from pathlib import Path

TEXT = """\
schema_version: 1
loop: {rate_hz: 200, cpu: 1, priority: 80, spin_us: 10, limits: simulation}
start: {lift_s: 0.5, settle_s: 0.2, authority_s: 0.5, ramp_s: 0.5}
drivers: {cell: {driver: simulated, device: bench, axes: [x]}}
signals: {strain_x: {driver: cell, max_age_us: null}}
outputs: {voltage_x: {driver: cell, range_V: [-20, 150], slew_V_per_ms: 40, park_V: 0}}
reference: {source: hold, offset_um: 60}
axes:
  x:
    mode: voltage
    centre_um: 66
    setpoint: {range_um: [2, 128]}
    inner: {mode: pid, K_V_per_um: 0.6, Ti_ms: 0.571, Td_ms: 0.167, filter_ms: 0.3}
"""

if __name__ == "__main__":
    Path(sys.argv[1]).write_text(TEXT)
