"""The configurations of the scenarios in a virtual machine: slow enough for an emulated processor.

``vm_cell.py FOLDER`` writes those that compile, elsewhere, all that the scenarios run: `cell.yaml` as it is, `can.yaml`
and `device.yaml`, which is for simulate-device, with buses that need no kernel.
"""

import shutil
import sys
from pathlib import Path

DATABASES = Path(__file__).parents[2] / "config" / "can"
FRAMES = Path("/run/can-databases")

_LOOP = """\
schema_version: 1
loop: {rate_hz: 200, cpu: 1, priority: 80, spin_us: 10, limits: simulation}
start: {lift_s: 0.5, settle_s: 0.2, authority_s: 0.5, ramp_s: 0.5}
"""
_AXIS = """\
reference: {source: hold, offset_um: 60}
axes:
  x:
    mode: voltage
    centre_um: 66
    setpoint: {range_um: [2, 128]}
    inner: {mode: pid, K_V_per_um: 0.6, Ti_ms: 0.571, Td_ms: 0.167, filter_ms: 0.3}
"""

TEXT = f"""\
{_LOOP}
drivers: {{cell: {{driver: simulated, device: bench, axes: [x]}}}}
signals: {{strain_x: {{driver: cell, max_age_us: null}}}}
outputs: {{voltage_x: {{driver: cell, range_V: [-20, 150], slew_V_per_ms: 40, park_V: 0}}}}
{_AXIS}"""

CAN_TEXT = f"""\
{_LOOP}
faults:
  host: {{silent_ms: 5000}}
  link: {{silent_ms: 3000, loop_silent_ms: 2000}}
drivers:
  can0:
    driver: canbus
    simulated: true
    interface: socketcan
    channel: vcan0
    bitrate: 1000000
    data_bitrate: 5000000
    database: manipulator.dbc
    receive: {{Sensors: {{rate_hz: 50, counter: Count, status: {{signal: Status}}}}}}
    send: {{Voltages: {{rate_hz: 50, counter: Count}}}}
signals: {{strain_x: {{driver: can0, channel: Sensors.strain_x, max_age_us: null}}}}
outputs: {{voltage_x: {{driver: can0, channel: Voltages.voltage_x, range_V: [-20, 150], slew_V_per_ms: 40, park_V: 0}}}}
simulation: {{force: {{static_N: 0, tooth_N: 0, noise_N: 0}}}}
{_AXIS}"""


def write(folder, name, text):
    """The configuration with the frames that it speaks of; its path."""
    shutil.copy(DATABASES / "manipulator.dbc", folder)
    file = Path(folder) / name
    file.write_text(text)
    return file


if __name__ == "__main__":
    write(sys.argv[1], "cell.yaml", TEXT)
    write(sys.argv[1], "can.yaml", CAN_TEXT.replace("socketcan", "virtual"))
    write(sys.argv[1], "device.yaml", CAN_TEXT.replace("socketcan", "micromanip"))
