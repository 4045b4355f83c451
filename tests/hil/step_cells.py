"""Cells whose axes are held at 60 V in open loop, on each bus: only a voltage's way to its device is looked at."""

import os

from campaigns.fault_cells import assembled, free_port, patient_can_cell
from tests.cells import changed

HELD_V, PARK_V, RANGE_V = 60.0, 0.0, (-20.0, 100.0)
SLEW_V_PER_S, RAMP_S = 500.0, 0.3

BUSES = {"can": 200.0, "gcs": 100.0, "modbus": 100.0, "line": 100.0}
"""How often a voltage is sent (Hz)."""
CUTS = {bus: "bus_off" if bus == "can" else "unplug" for bus in BUSES}
"""What cuts the link, for the device's commands."""

# the device has no watchdog, and neither an amplifier nor an age that a stall of the machine would trip
_CAN = (
    ("watchdog: {ms: 300, rest_ms: 250, after_power_on: rest}", "watchdog: {ms: null, after_power_on: last}"),
    ("start: {lift_s: 0.2, ", "start: {lift_s: 0.3, "),
    ("ramp_s: 0.2}", "ramp_s: 0.3}"),
    ("max_age_us: 200000, range_um: [-30, 150]", "max_age_us: null"),
    ("  amplifier_ok_x: {driver: cell, channel: Sensors.amplifier_ok_x, max_age_us: 1000000}\n", ""),
    ("switches: {amplifier_enable: {driver: cell, channel: Voltages.amplifier_enable}}\n", ""),
    ("range_V: [-20, 150], slew_V_per_ms: 2,", "range_V: [-20, 100], slew_V_per_ms: 0.5,"),
    ("mode: strain", "mode: voltage"),
)
_OTHERS = (
    ("max_age_us: 100000, range_um: [-30, 150]", "max_age_us: null"),
    ("silence_ms: 200", "silence_ms: 1000"),
    ("timeout_ms: 50", "timeout_ms: 80"),
    ("source: jog, offset_um: 60, range_um: [20, 110]", "source: hold, offset_um: 60"),
    ("mode: strain", "mode: voltage"),
)
SERIAL_LINE = f"/tmp/micromanip-steps-{os.getpid()}"


def step_cell(bus):
    """The configuration of one bus, on a port of its own."""
    if bus == "can":
        text = changed(patient_can_cell(), *_CAN)
    else:
        unit = "cell." if bus == "modbus" else ""
        place = SERIAL_LINE if bus == "line" else free_port()
        text = assembled("watched", bus, place=place, inputs=unit, outputs=unit)
        for old, new in _OTHERS:  # some are there for each axis, some on one bus only
            text = text.replace(old, new)
    return text + "faults: {hold: {timeout_s: 0.3}}\n"


def step_V(bus):
    """What one write may differ from the one before."""
    return SLEW_V_PER_S / BUSES[bus]
