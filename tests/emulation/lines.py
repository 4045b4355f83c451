"""Devices on lines of their own, in virtual time, as a plain program at the other end sees them."""

CELL = """\
schema_version: 2
loop: {{rate_hz: 10000, limits: simulation}}
drivers:
  device:
    driver: line
    simulated: true
{driver}
signals:
{signals}
{outputs}
reference: {{source: step, offset_um: 50, step_um: 5}}
axes:
  x: &axis
    mode: strain
    centre_um: 50
    setpoint: {{range_um: [0, 120], slew_um_per_ms: 1}}
    inner: {{mode: pid, K_V_per_um: 0.2, Ti_ms: 5, Td_ms: 0, filter_ms: 0.3}}
  y: *axis
simulation:
  axes: [x, y]
  plant: {{strain_noise_nm: 0.0, strain_hum_nm: 0.0, stage_noise_nm: 0.0}}
  tracker: {{rate_Hz: 1000.0, latency_ms: 1.0, noise_um: 0.5}}
"""
OUTPUTS = """\
outputs:
  voltage_x: {driver: device, channel: voltage_x, range_V: [-20, 120], slew_V_per_ms: 10}
  voltage_y: {driver: device, channel: voltage_y, range_V: [-20, 120], slew_V_per_ms: 10}"""

ELSEWHERE = OUTPUTS.replace("device,", "spare,")
"""Outputs of a second driver, for a device that only measures."""

BOARD = """\
    serial: {{device: {device}, baud: 4000000}}
    silence_ms: 200
    watchdog: {{ms: 100, rest_ms: 250, after_power_on: rest}}
    binary:
      sync: aa 55
      length: {{at: 2, type: uint8, plus: 5}}
      kind: {{at: 3, type: uint8}}
      crc: {{name: crc8.smbus, first: 2}}
      identity:
        request: aa 55 00 01
        kind: 0x81
        numbers: {{serial_number: {{at: 4, type: uint32, byte_order: little, value: 1234}}}}
      receive:
        strains:
          kind: 0x10
          rate_hz: 2000
          counter: {{at: 4, type: uint16, byte_order: little}}
          status: {{at: 6, type: uint8, good: [0]}}
          fields:
            strain_x: {{at: 7, type: int32, byte_order: little, scale: 1.0e-4}}
            strain_y: {{at: 11, type: int32, byte_order: big, scale: 1.0e-4, offset: -2.5}}
        monitor:
          kind: 0x11
          rate_hz: 100
          fields: {{true_strain_x: {{at: 4, type: float32, byte_order: big}}}}
      send:
        voltages:
          kind: 0x20
          rate_hz: 2000
          cyclic_safe: true
          counter: {{at: 4, type: uint16, byte_order: little}}
          fields:
            voltage_x: {{at: 6, type: int16, byte_order: little, scale: 0.005, range: [-20, 150]}}
            voltage_y: {{at: 8, type: int16, byte_order: little, scale: 0.005, range: [-20, 150]}}
        ask: {{kind: 0x30, rate_hz: 100, reply: monitor}}
"""
"""A board that speaks in binary frames, for `driver` of ``write_cell``."""

GCS = """\
    {port}
    silence_ms: 500
    watchdog: {{ms: 100, rest_ms: 250, after_power_on: rest}}
    ascii:
      preset: gcs
      identity: Physik Instrumente.*E-727
      read:
        strains:
          command: POS?
          rate_hz: 100
          fields: {{strain_x: {{item: "1"}}, strain_y: {{item: "2", scale: 0.5, offset: 1.0}}}}
      write:
        voltages:
          command: SVA
          rate_hz: 100
          cyclic_safe: true
          fields:
            voltage_x: {{item: "1", range: [-20, 120]}}
            voltage_y: {{item: "2", range: [-20, 120]}}
"""
CAPACITIVE = """\
    tcp: {{host: 127.0.0.1, port: {port}}}
    silence_ms: 100
    stream:
      magic: 4d 45 41 53
      header_bytes: 32
      identity: {{serial_number: {{at: 8, type: int32, byte_order: little, value: 4711}}}}
      status: {{at: 20, type: uint32, byte_order: little, good: [0]}}
      blocks: {{at: 24, type: uint16, byte_order: little, most: 8}}
      counter: {{at: 28, type: uint32, byte_order: little, counts: samples}}
      rate_hz: 4000
      block_bytes: 8
      fields:
        strain_x: {{at: 0, type: int32, byte_order: little, scale: 1.0e-5}}
        strain_y: {{at: 4, type: int32, byte_order: little, scale: 1.0e-5}}
"""
TRACKER = """\
    udp: {{host: 127.0.0.1, port: {port}, listen: {listen}}}
    silence_ms: 100
    stream:
      magic: 4c 54
      header_bytes: 16
      counter: {{at: 4, type: uint32, byte_order: big, counts: packets}}
      time: {{at: 8, type: uint64, byte_order: big, unit_s: 1.0e-6}}
      rate_hz: 1000
      block_bytes: 16
      crc: {{name: crc32.iso_hdlc, byte_order: big}}
{more}
      fields:
        strain_x: {{at: 0, type: float64, byte_order: big, scale: 1000.0}}
        strain_y: {{at: 8, type: float64, byte_order: big, scale: 1000.0}}
"""


def signal(name, channel=None):
    """A line of the section signals."""
    return f"  {name}: {{driver: device, channel: {channel or name}, max_age_us: 20000}}"


def write_cell(folder, driver, signals=("strain_x", "strain_y"), outputs=OUTPUTS):
    """A configuration with one driver `device`, whose keys are the text `driver`."""
    file = folder / "cell.yaml"
    if outputs is ELSEWHERE:
        driver += "  spare: {driver: simulated, axes: [x, y]}\n"
    lines = "\n".join(signal(*((name,) if isinstance(name, str) else name)) for name in signals)
    file.write_text(CELL.format(driver=driver.rstrip("\n"), signals=lines, outputs=outputs), encoding="utf-8")
    return file
