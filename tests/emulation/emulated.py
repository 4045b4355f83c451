"""Devices of a configuration in virtual time, with a controller that knows nothing but the DBC file and cantools."""

import itertools
import os

import cantools
from testbus.virtual_bus import VirtualLoop

from campaigns.report import CONFIG
from micromanip.emulation.devices import Devices
from micromanip.testbus.frame import Frame

DATABASE = cantools.database.load_file(CONFIG / "can" / "manipulator.dbc")
AT_REST = dict.fromkeys(("voltage_x", "voltage_y", "voltage_z", "feed_hold", "heartbeat"), 0) | {"amplifier_enable": 1}
_numbers = itertools.count()


def configuration(folder, *changes, name="can.yaml"):
    """A configuration of config/ on a channel of its own, with parts of its text replaced."""
    text = (CONFIG / name).read_text(encoding="utf-8")
    own = ("channel: can0\n", f"channel: played-{os.getpid()}-{next(_numbers)}\n")
    for old, new in (own, (" can/", f" {CONFIG}/can/"), *changes):
        assert old in text, old
        text = text.replace(old, new)
    file = folder / "cell.yaml"
    file.write_text(text, encoding="utf-8")
    return file


class Controller:
    """Hears what the devices send, and commands them."""

    def __init__(self, file, **options):
        self.devices = Devices(file, loop=VirtualLoop(), **options)
        self.heard = []
        self._count = 0
        self._line = self.devices.emulated["can0"].line
        self._line.attach(self)
        self.devices.start()

    def on_frame(self, frame, time_ns):
        self.heard.append((time_ns, frame))

    def decoded(self, name):
        """All frames of a message that were heard: pairs of time (ns) and values."""
        message = DATABASE.get_message_by_name(name)
        return [
            (time_ns, message.decode(frame.data, decode_choices=False))
            for time_ns, frame in self.heard
            if frame.identifier == message.frame_id
        ]

    def newest(self, name="Sensors"):
        return self.decoded(name)[-1][1]

    def command(self, **values):
        """Send the commands, at rest but for `values`."""
        message = DATABASE.get_message_by_name("Voltages")
        data = message.encode(AT_REST | values | {"Count": self._count % 256})
        self._count += 1
        assert self._line.send(self, Frame(message.frame_id, data, fd=True, bitrate_switch=True))

    def command_for(self, seconds, **values):
        """Send them a thousand times a second."""
        for _ in range(round(seconds * 1e3)):
            self.command(**values)
            self.run(1e-3)

    def run(self, seconds):
        self.devices.loop.run(self.devices.loop.time_ns + round(seconds * 1e9))

    def order(self, line):
        """A line of JSON; its answer."""
        return self.devices.command(line)

    def close(self):
        self.devices.close()
