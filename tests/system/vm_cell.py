"""The configuration of the scenarios in a virtual machine: slow enough for an emulated processor.

``vm_cell.py FILE`` writes it with a bus that needs no kernel, for compiling elsewhere all that the scenarios run.
"""

import shutil
import sys
from pathlib import Path

DATABASES = Path(__file__).parents[2] / "config" / "can"
FRAMES = Path("/run/can-databases")

TEXT = """\
schema_version: 2
loop: {rate_hz: 200, cpu: 1, priority: 80, spin_us: 10, limits: simulation}
start: {lift_s: 0.5, settle_s: 0.2, authority_s: 0.5, ramp_s: 0.5}
faults:
  host: {silent_ms: 5000}
  link: {silent_ms: 3000, loop_silent_ms: 2000}
drivers:
  can0:
    driver: canbus
    simulated: true
    interface: socketcan
    channel: vcan0
    bitrate: 1000000
    data_bitrate: 5000000
    database: manipulator.dbc
    receive: {Sensors: {rate_hz: 50, counter: Count, status: {signal: Status}}}
    send: {Voltages: {rate_hz: 50, counter: Count}}
    silence_ms: 3000
signals: {strain_x: {driver: can0, channel: Sensors.strain_x, max_age_us: null}}
outputs: {voltage_x: {driver: can0, channel: Voltages.voltage_x, range_V: [-20, 150], slew_V_per_ms: 40, park_V: 0}}
simulation: {force: {static_N: 0, tooth_N: 0, noise_N: 0}}
reference: {source: hold, offset_um: 60}
axes:
  x:
    mode: voltage
    centre_um: 66
    setpoint: {range_um: [2, 128]}
    inner: {mode: pid, K_V_per_um: 0.6, Ti_ms: 0.571, Td_ms: 0.167, filter_ms: 0.3}
"""


def write(file, text=TEXT):
    """The configuration, beside it the frames that it speaks of; its path."""
    file = Path(file)
    shutil.copy(DATABASES / "manipulator.dbc", file.parent)
    file.write_text(text)
    return file


if __name__ == "__main__":
    write(sys.argv[1], TEXT.replace("socketcan", "micromanip"))
