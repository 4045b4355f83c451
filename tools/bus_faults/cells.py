"""The examples of config/ for a campaign: on ports and channels of their own, ready and not armed."""

import os
import re
import socket
from pathlib import Path

CONFIG = Path(__file__).parents[2] / "config"


def changed(name, *changes):
    """The example called `name`, each (pattern, replacement) done once."""
    text = (CONFIG / name).read_text(encoding="utf-8")
    for pattern, replacement in ((r"arm_on_start: true ", "arm_on_start: false"), *changes):
        text, count = re.subn(pattern, replacement, text)
        assert count == 1, f"{name}: {pattern} is there {count} times"
    return text


def can_cell(*changes):
    """CAN FD at 2 kHz."""
    channel = (r"channel: can0\n", f"channel: faults-{os.getpid()}\n")
    return changed("can.yaml", channel, (r"database: can/", f"database: {CONFIG}/can/"), *changes)


PATIENT = """\
schema_version: 2
loop: {{rate_hz: 500, cpu: null, spin_us: 10, limits: simulation}}
start: {{lift_s: 0.2, check_s: null, sweep_s: 0.0, settle_s: 0.0, authority_s: 0.2, ramp_s: 0.2}}
drivers:
  can0:
    driver: canbus
    simulated: true
    interface: micromanip
    channel: patient-{number}
    bitrate: 1000000
    data_bitrate: 5000000
    database: {database}
    receive: {{Sensors: {{rate_hz: 200, counter: Count, status: {{signal: Status}}}}}}
    send: {{Voltages: {{rate_hz: 200, counter: Count}}}}
    watchdog: the amplifier ramps to 0 V in 0.2 s when no command comes for 300 ms
signals:
  strain_x: {{driver: can0, channel: Sensors.strain_x, max_age_us: 200000, range_um: [-30, 150]}}
  amplifier_ok_x: {{driver: can0, channel: Sensors.amplifier_ok_x, max_age_us: 1000000}}
outputs:
  voltage_x: {{driver: can0, channel: Voltages.voltage_x, range_V: [-20, 150], slew_V_per_ms: 2, park_V: 0}}
switches: {{amplifier_enable: {{driver: can0, channel: Voltages.amplifier_enable}}}}
reference: {{source: hold, offset_um: 60}}
axes:
  x:
    mode: strain
    centre_um: 66
    setpoint: {{range_um: [2, 128], slew_um_per_ms: 0.5}}
    inner: {{mode: pid, K_V_per_um: 0.05, Ti_ms: 5.0, Td_ms: 0.0, filter_ms: 1.0}}
simulation: {{seed: 1, axes: [x], lines: {{}}}}
"""
PATIENT_WATCHDOG_MS = 300.0


def patient_can_cell():
    """An axis at rest on a bus of 200 Hz, whose limits a machine that others share keeps."""
    return PATIENT.format(number=os.getpid(), database=CONFIG / "can" / "manipulator.dbc")


def watched_can_cell():
    """The same with a watch over the agreement of the sensors.

    It is off among the limits of a simulation: a stall of the machine would be taken for it too.
    """
    return can_cell((r"(?m)^(    strain: \{coast_ms.*)$", r"\1\n    disagreement: {ratio: 3.0e+4}"))


def modbus_cell():
    """Modbus TCP at 500 Hz."""
    return changed("modbus.yaml", (r"port: 5020", f"port: {free_port()}"))


def serial_cell():
    """A board on a line at 2 kHz."""
    return changed("serial.yaml", (r"/tmp/micromanip-board", f"/tmp/micromanip-faults-{os.getpid()}"))


def gcs_cell():
    """A GCS controller over TCP at 100 Hz, a tracker over UDP."""
    return changed(
        "gcs.yaml",
        (r"port: 50000", f"port: {free_port()}"),
        (r"port: 5500, listen: 7001", f"port: {free_port(socket.SOCK_DGRAM)}, listen: {free_port(socket.SOCK_DGRAM)}"),
    )


def free_port(kind=socket.SOCK_STREAM):
    """A port that nobody has just now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
