"""Compiled code and Python play the same device on the same bus: frame for frame, bit for bit, ns for ns."""

import math
import random
import threading

import can
import cantools
import numpy as np
import pytest
from testbus.virtual_bus import VirtualLoop

from micromanip.emulation.can.canbus import DbcMessage
from micromanip.emulation.can.frames import FIELD, code_at, fill_field, has_tables, put_nearest, value_at
from micromanip.emulation.can.steady_buses import SteadyBuses
from micromanip.emulation.devices import Devices
from micromanip.testbus.client import HubBus
from micromanip.testbus.frame import STAMP

from .emulated import AT_REST, DATABASE, configuration

pytestmark = pytest.mark.compiled_only

MS = 1_000_000


def laid_out(seed):
    """A message of random signals of both byte orders that do not overlap."""
    draw, lines, taken = random.Random(seed), [], set()
    for number in range(draw.randint(1, 8)):
        bits, big = draw.choice((1, 3, 8, 12, 16, 24, 33, 53)), draw.random() < 0.5
        kind = draw.choice("+-") if bits > 1 else "+"
        places = [draw.randrange(512)]
        while len(places) < bits:
            places.append(places[-1] + (1 if not big else -1 if places[-1] % 8 else 15))
        if max(places) < 512 and not taken & set(places):
            taken |= set(places)
            scale, offset = draw.choice(("1", "0.0001", "-0.5", "0.00275")), draw.choice(("0", "-22", "1000.5"))
            lines.append(f' SG_ s{number} : {places[0]}|{bits}@{0 if big else 1}{kind} ({scale},{offset}) [0|0] "" B')
    text = 'VERSION ""\nBU_: A B\nBO_ 256 M: 64 A\n' + "\n".join(lines) + "\n"
    return draw, cantools.database.load_string(text, database_format="dbc").messages[0]


@pytest.mark.parametrize("seed", range(15))
def test_any_message_is_coded_as_cantools_does(seed):
    draw, layout = laid_out(seed)
    message, scratch = DbcMessage(layout, counter=None), np.zeros(1, np.uint64)
    assert has_tables(layout)
    for _ in range(4):
        values = {name: draw.choice((draw.gauss(0, 1e3), draw.gauss(0, 1e9), 0.0)) for name in message.signals}
        data = np.zeros(64, np.uint8)
        for signal in layout.signals:
            field = np.zeros(1, FIELD)[0]
            fill_field(field, signal, message.ends[signal.name], 0)
            assert put_nearest(field, data, 0, values[signal.name], scratch)
        frame = message.frame(values, 0)
        assert data.tobytes() == frame.data
        for signal in layout.signals:
            field = np.zeros(1, FIELD)[0]
            fill_field(field, signal, message.ends[signal.name], 0)
            assert value_at(field, data, 0, scratch) == message.values(frame)[signal.name]
            assert code_at(field, data, 0) < 1 << signal.length
            assert not put_nearest(field, data, 0, math.nan, scratch)


class Cell:
    """Devices and one client in virtual time; where they are `compiled`, compiled code has all that it takes."""

    def __init__(self, folder, compiled):
        self.devices = Devices(configuration(folder), loop=VirtualLoop())
        self.hub = self.devices.emulated["can0"].bus.line
        self.steady = (
            SteadyBuses.of(self.devices.loop, self.devices.cell, self.devices.emulated.values()) if compiled else None
        )
        self.devices._steady = self.steady
        self.heard, self.bus, self.count, self.lent = [], None, 0, 0
        self.devices.start()

    def connect(self):
        at = self.devices.loop
        self.bus = HubBus.__new__(HubBus)
        greeted = []

        def connect():
            self.bus.__init__(self.hub.channel, fd=True)
            greeted.append(True)

        thread = threading.Thread(target=connect)
        thread.start()
        while not greeted:
            at.run(at.time_ns)
        thread.join()

    def command(self, **values):
        """As a client whose clock is the cell's."""
        layout = DATABASE.get_message_by_name("Voltages")
        data = layout.encode(AT_REST | values | {"Count": self.count % 256})
        self.count, self.commanded_ns = self.count + 1, self.devices.loop.time_ns
        message = can.Message(
            arbitration_id=layout.frame_id, data=data, is_extended_id=False, is_fd=True, bitrate_switch=True
        )
        self.bus._sock.send(STAMP.pack(self.devices.loop.time_ns) + self.bus._packed(message))

    def run(self, ms):
        loop = self.devices.loop
        end_ns = loop.time_ns + round(ms * MS)
        while loop.time_ns < end_ns:
            loop.run(min(end_ns, loop.time_ns + 100_000))
            if self.steady is not None:
                self.steady.catch_up(loop.time_ns)
                self.lent += self.steady.is_lent
            while (message := self.bus._recv_internal(0)[0]) is not None:
                self.heard.append((round(message.timestamp * 1e9), message.arbitration_id, bytes(message.data)))

    def close(self):
        self.bus.shutdown()
        self.devices.close()


@pytest.fixture
def pair(tmp_path):
    made = []
    for name in ("python", "compiled"):
        (tmp_path / name).mkdir()
        made.append(Cell(tmp_path / name, name == "compiled"))
        made[-1].connect()
    yield made
    for cell in made:
        cell.close()


def worked(cell):
    """What a cell goes through: commands of changing size, a fault in the middle, silence until its watchdog trips."""
    draw = random.Random(3)
    for step in range(120):
        cell.command(voltage_x=20 + 0.2 * step, voltage_y=draw.uniform(0, 60), voltage_z=5.0)
        cell.run(draw.choice((0.3, 0.5, 0.7)))
        cell.run(0.05)  # orders come between the instants at which samples are due
        if step == 50:
            cell.devices.command('{"device": "offset", "signal": "strain_x", "value": 3.0, "for_s": 0.01}')
        if step == 60:
            cell.devices.command('{"inject": "drop", "share": 0.5, "for_s": 0.01}')
    cell.run(150)
    return cell.devices.report()


def test_compiled_and_python_say_the_same(pair):
    python, compiled = pair
    reports = [worked(cell) for cell in pair]
    assert len(python.heard) > 300
    assert compiled.lent > 300, "compiled code had its part"
    tripped = next(i for i, (time_ns, *_) in enumerate(python.heard) if time_ns > python.commanded_ns + 100 * MS)
    assert compiled.heard[:tripped] == python.heard[:tripped]
    for name in ("devices", "outputs", "switches", "amplifier_trips", "refused_commands"):
        assert reports[1][name] == reports[0][name], name
