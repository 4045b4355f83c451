"""CANopen nodes with the plant behind them, commanded by hand-made frames."""

import pytest
from testbus.virtual_bus import VirtualLoop

from micromanip.emulation.devices import Devices
from micromanip.testbus.frame import Frame

from .emulated import CONFIG, configuration

SENSOR, AMPLIFIER = 5, 6
NODES = f"""
    sync_hz: 1000
    nodes:
      gauge:
        node_id: {SENSOR}
        eds: {CONFIG}/can/sensor.eds
        heartbeat_ms: 150
        tpdo:
          1: {{rate_hz: 1000, signals: {{s: {{object: strain_x, scale: 1.0e-4}}, stage_x: {{scale: 1.0e-4}}}}}}
          2: {{rate_hz: 1000, signals: {{strain_y: {{scale: 1.0e-4}}, stage_y: {{scale: 1.0e-4}}}}}}
      amplifier:
        node_id: {AMPLIFIER}
        eds: {CONFIG}/can/amplifier.eds
        heartbeat_ms: 150
        rpdo:
          1:
            rate_hz: 1000
            signals:
              x: {{object: voltage_x, scale: 0.005}}
              voltage_y: {{scale: 0.005}}
              voltage_z: {{scale: 0.005}}
"""
OF_FRAMES = (CONFIG / "can.yaml").read_text(encoding="utf-8").replace(" can/", f" {CONFIG}/can/")
CHANGES = (
    ("driver: canbus", "driver: canopen"),
    (OF_FRAMES[OF_FRAMES.index("    data_bitrate:") : OF_FRAMES.index("\nsignals:")], ""),
    ("channel: Sensors.strain_x", "channel: gauge.s"),
    ("channel: Sensors.strain_y", "channel: gauge.strain_y"),
    ("channel: Voltages.voltage_x", "channel: amplifier.x"),
    ("channel: Voltages.voltage_", "channel: amplifier.voltage_"),
    ("  amplifier_enable: {driver: can0, channel: Voltages.amplifier_enable}\n", ""),
    ("interface: micromanip ", f"{NODES.strip()}\n    interface: micromanip "),
)


class Master:
    def __init__(self, file):
        self.devices = Devices(file, loop=VirtualLoop())
        self.heard = []
        self.line = self.devices.emulated["can0"].bus.line
        self.line.attach(self)
        self.devices.start()
        self.run(0.01)

    def on_frame(self, frame, time_ns):
        self.heard.append(frame)

    def run(self, seconds):
        self.devices.loop.run(self.devices.loop.time_ns + round(seconds * 1e9))

    def send(self, identifier, data=b""):
        self.line.send(self, Frame(identifier, bytes(data)))

    def operational(self):
        self.send(0x000, (1, 0))
        self.run(0.001)

    def cycle(self, seconds, *volts):
        for _ in range(round(seconds * 1e3)):
            data = b"".join(round(v / 0.005).to_bytes(2, "little", signed=True) for v in volts)
            self.send(0x200 + AMPLIFIER, data)
            self.send(0x080)
            self.run(0.001)

    def strain_um(self, number=1):
        """Of the newest TPDO of that number."""
        frame = [frame for frame in self.heard if frame.identifier == 0x80 + 0x100 * number + SENSOR][-1]
        return int.from_bytes(frame.data[:3], "little", signed=True) * 1e-4

    def boots(self, node_id):
        return sum(frame.identifier == 0x700 + node_id and frame.data == b"\0" for frame in self.heard)


@pytest.fixture
def master(tmp_path):
    file = configuration(tmp_path, *CHANGES)
    master = Master(file)
    yield master
    master.devices.close()


def test_nodes_measure_and_move_the_plant(master):
    master.operational()
    master.cycle(0.1, 0.0, 0.0, 0.0)
    rest = master.strain_um(1), master.strain_um(2)
    master.cycle(0.1, 50.0, 0.0, 0.0)
    assert master.strain_um(1) - rest[0] > 20.0
    assert abs(master.strain_um(2) - rest[1]) < 1.0
    assert master.devices.report()["outputs"]["voltage_x"]["max"] == pytest.approx(50.0)
    assert "2 messages out, 1 in, 1000 kbit/s, nodes gauge, amplifier" in master.devices.emulated["can0"].ready


def test_reboot(master):
    master.operational()
    master.cycle(0.1, 50.0, 0.0, 0.0)
    boots = master.boots(SENSOR)
    assert master.devices.command('{"device": "reboot", "for_s": 0.2}') == {"ok": True}
    master.run(0.001)
    master.heard.clear()
    master.cycle(0.19, 50.0, 0.0, 0.0)
    assert not master.heard
    assert master.devices.cell.voltages()["voltage_x"] == 0.0
    master.run(0.05)
    assert (master.boots(SENSOR), master.boots(AMPLIFIER)) == (boots, boots) == (1, 1)
