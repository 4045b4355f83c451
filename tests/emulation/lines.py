"""Devices on lines of their own, in virtual time, as a plain program at the other end sees them."""

import contextlib
import json
import os
import select
import socket
import time

from testbus.virtual_bus import VirtualLoop

from micromanip.emulation.devices import Devices

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
    watchdog: outputs to 0 V
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


def free_port(kind=socket.SOCK_STREAM):
    """A port of this machine that nobody uses."""
    with socket.socket(socket.AF_INET, kind) as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


class Bench:
    """The played device of a configuration, and whoever connects to it."""

    def __init__(self, file, **options):
        self.devices = Devices(file, loop=VirtualLoop(), **options)
        self.played = self.devices.emulated["device"]
        self.devices.start()
        self._closing = contextlib.ExitStack()

    @property
    def loop(self):
        return self.devices.loop

    @property
    def cell(self):
        return self.devices.cell

    def run(self, seconds):
        self.loop.run(self.loop.time_ns + round(seconds * 1e9))

    def until(self, condition, within_s=5.0):
        """Let virtual time pass, in small steps, until `condition` holds: the kernel needs real time of its own."""
        give_up = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < give_up, "it does not come"
            self.run(0.0002)

    def open(self, device):
        """A serial port, as a file descriptor."""
        fileno = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._closing.callback(os.close, fileno)
        self.run(0.01)
        return Client(self, fileno)

    def connect(self, port, receive_buffer=None):
        """A TCP connection."""
        link = self._closing.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
        if receive_buffer is not None:
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        link.connect(("127.0.0.1", port))
        self.run(0.001)
        return Client(self, link.fileno())

    def order(self, **command):
        """A line of JSON; its answer."""
        return self.devices.command(json.dumps(command))

    def figures(self):
        return self.devices.report()["devices"]["device"]

    def close(self):
        self._closing.close()
        self.devices.close()


class Client:
    """A plain program at the other end of a line."""

    def __init__(self, bench, fileno):
        self._bench, self.fileno, self.got = bench, fileno, b""

    def read(self):
        """What is there now."""
        data = b""
        while select.select([self.fileno], [], [], 0)[0]:
            part = os.read(self.fileno, 65536)
            if not part:
                break
            data += part
        return data

    def write(self, data):
        """Send bytes; the device has them soon."""
        before = self._bench.figures()["bytes_received"]
        os.write(self.fileno, data)
        self._bench.until(lambda: self._bench.figures()["bytes_received"] >= before + len(data))

    def read_bytes(self, count):
        """So many bytes, as virtual time passes."""
        self._bench.until(lambda: self._gather() >= count)
        data, self.got = self.got[:count], self.got[count:]
        return data

    def ask(self, line, end=b"\n", lines=1):
        """Send a line of text, and read so many."""
        self.write(line + end)
        self._bench.until(lambda: self._gather() and self.got.count(b"\n") >= lines)
        data, self.got = self.got, b""
        return data

    def silence(self, seconds=0.02):
        """Whatever comes meanwhile."""
        self._bench.run(seconds)
        time.sleep(0.02)
        self._gather()
        data, self.got = self.got, b""
        return data

    def _gather(self):
        self.got += self.read()
        return len(self.got)
