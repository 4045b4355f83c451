"""One axis held at 60 V in open loop, on each bus: nothing but the way of a voltage to its device is looked at."""

import os

from tools.bus_faults.cells import CONFIG, free_port

HELD_V, PARK_V, RANGE_V = 60.0, 0.0, (-20.0, 100.0)
SLEW_V_PER_S, RAMP_S = 1500.0, 0.2

CELL = """\
schema_version: 2
loop: {{rate_hz: 500, cpu: null, spin_us: 10, limits: simulation}}
start: {{lift_s: 0.3, check_s: null, sweep_s: 0.0, settle_s: 0.0, authority_s: 0.2, ramp_s: {ramp_s}}}
drivers:
{drivers}
signals:
  strain_x: {{driver: bus, channel: {strain}, max_age_us: null}}
outputs:
  voltage_x: {{driver: bus, channel: {voltage}, range_V: [{low}, {high}], slew_V_per_ms: {slew}, park_V: {park}}}
reference: {{source: hold, offset_um: {held}}}
axes:
  x:
    mode: voltage
    centre_um: 66
    setpoint: {{range_um: [2, 128], slew_um_per_ms: 0.5}}
    inner: {{mode: pid, K_V_per_um: 0.05, Ti_ms: 5.0, Td_ms: 0.0, filter_ms: 1.0}}
faults: {{hold: {{timeout_s: 0.3}}}}
simulation: {{seed: 1, axes: [x], lines: {{}}}}
"""
CAN = """\
  bus:
    driver: canbus
    simulated: true
    interface: micromanip
    channel: steps-{number}
    bitrate: 1000000
    data_bitrate: 5000000
    database: {config}/can/manipulator.dbc
    receive: {{Sensors: {{rate_hz: 200, counter: Count, status: {{signal: Status}}}}}}
    send: {{Voltages: {{rate_hz: 200, counter: Count}}}}
    watchdog: none in this test
"""
MODBUS = """\
  bus:
    driver: modbus
    simulated: true
    tcp: {{host: 127.0.0.1, port: {port}}}
    timeout_ms: 80
    response_ms: 1
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
            read: {{strain_x: {{address: 0, type: int32, scale: 1.0e-4}}}}
            write: {{voltage_x: {{address: 100, type: int16, scale: 0.005, cyclic_safe: true}}}}
    watchdog: none in this test
"""
SERIAL = """\
  bus:
    driver: line
    simulated: true
    serial: {{device: {link}, baud: 4000000}}
    silence_ms: 500
    watchdog: none in this test
    binary:
      sync: aa 55
      length: {{at: 2, type: uint8, plus: 6}}
      kind: {{at: 3, type: uint8}}
      crc: {{name: crc16.ibm_3740, byte_order: big, first: 2}}
      receive:
        sensors:
          kind: 0x10
          rate_hz: 200
          fields: {{strain_x: {{at: 4, type: int32, byte_order: little, scale: 1.0e-4}}}}
      send:
        voltages:
          kind: 0x20
          rate_hz: 200
          cyclic_safe: true
          fields: {{voltage_x: {{at: 4, type: int16, byte_order: little, scale: 0.005, range: [-20, 150]}}}}
"""
GCS = """\
  bus:
    driver: line
    simulated: true
    tcp: {{host: 127.0.0.1, port: {port}}}
    silence_ms: 1000
    watchdog: none in this test
    ascii:
      preset: gcs
      identity: Physik Instrumente.*E-727
      reply_ms: 100
      read: {{strains: {{command: "POS?", rate_hz: 50, fields: {{strain_x: {{item: "1"}}}}}}}}
      write:
        voltages:
          command: SVA
          rate_hz: 50
          cyclic_safe: true
          fields: {{voltage_x: {{item: "1", range: [-20, 120], decimals: 4}}}}
"""
BUSES = {"can": (CAN, 200.0), "modbus": (MODBUS, 100.0), "serial": (SERIAL, 200.0), "gcs": (GCS, 50.0)}
"""Section of the driver, and how often a voltage is sent (Hz)."""
CUTS = {"can": "bus_off", "modbus": "unplug", "serial": "unplug", "gcs": "unplug"}
"""What cuts the link, for the device's commands."""
CHANNELS = {"can": ("Sensors.strain_x", "Voltages.voltage_x"), "modbus": ("cell.strain_x", "cell.voltage_x")}


def step_cell(bus, rest=PARK_V):
    """The configuration of one bus, on a port of its own."""
    number = os.getpid()
    drivers = BUSES[bus][0].format(
        number=number, config=CONFIG, port=free_port(), link=f"/tmp/micromanip-steps-{number}"
    )
    strain, voltage = CHANNELS.get(bus, ("strain_x", "voltage_x"))
    low, high = RANGE_V
    return CELL.format(
        drivers=drivers.rstrip(),
        ramp_s=RAMP_S,
        strain=strain,
        voltage=voltage,
        low=low,
        high=high,
        slew=SLEW_V_PER_S * 1e-3,
        park=rest,
        held=HELD_V,
    )


def step_V(bus):
    """What one write may differ from the one before."""
    return SLEW_V_PER_S / BUSES[bus][1]
