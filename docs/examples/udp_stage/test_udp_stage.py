"""The driver udp_stage against its contract: `pytest -rs docs/examples/udp_stage`."""

import select
import socket
import threading
import time

from udp_stage import wire
from udp_stage.device import Device
from udp_stage.driver import DATAGRAM_BITS, UdpStage

from micromanip.driver.conformance import BusDriverContract, Golden, Peer


class WatchedDevice(Device):
    """The stand-in, noting what it hears and says, and failing when it is told to."""

    def __init__(self, port):
        super().__init__(port=port)
        self.silent, self.left_out, self.forced_um = False, 0, {}
        self.datagrams, self.commands, self.said = [], [], 0

    def answer(self, datagram, sender):
        if not self.silent:
            self.datagrams.append(datagram)
            super().answer(datagram, sender)

    def command(self, voltages_V):
        self.commands.append(dict(zip(("voltage_x", "voltage_y"), voltages_V, strict=True)))
        super().command(voltages_V)

    def move(self):
        super().move()
        for axis, strain_um in self.forced_um.items():
            self.strains_um[axis] = strain_um

    def report(self):
        self.counter = (self.counter + self.left_out) % wire.COUNTS
        self.left_out = 0
        if not self.silent:
            super().report()

    def tell(self, datagram):
        self.said += self.listener is not None
        super().tell(datagram)


class UdpPeer(Peer):
    """That device in a thread, on a port of its own."""

    kind = WatchedDevice

    def __init__(self):
        self.device = self.thread = None
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]

    @property
    def options(self):
        return {"port": self.port, "serial_number": 7}

    def start(self):
        self.device, self.on = self.kind(self.port), True
        self.thread = threading.Thread(target=self.play, args=(self.device,))
        self.thread.start()

    def play(self, device):
        while self.on:
            device.step()

    def kill(self):
        if self.thread is not None:
            self.on = False
            self.thread.join()
            self.device.socket.close()
            self.thread = None

    def silence(self, silent):
        while not silent and select.select([self.device.socket], [], [], 0)[0]:
            time.sleep(0.001)  # what waits in this machine's own buffers would never reach an amplifier that hangs
        self.device.silent = silent

    def set_input(self, channel, value):
        self.device.forced_um["xy".index(channel[-1])] = value

    def writes(self):
        seen, self.device.commands = self.device.commands, []
        return seen

    def received(self):
        seen, self.device.datagrams = self.device.datagrams, []
        return seen

    def send(self, wire):
        self.device.tell(wire)

    def skip(self, count):
        self.device.left_out = count

    @property
    def counter_range(self):
        return wire.COUNTS

    def busy_s(self):
        datagrams = self.device.said + len(self.received())
        self.device.said = 0
        return {"link": datagrams * DATAGRAM_BITS / 100e6}


class TestUdpStage(BusDriverContract):
    """Every check of the suite, on this driver."""

    driver = UdpStage
    wrong_identity = {"serial_number": 8}
    out_of_range = (163.8376, -163.8426)
    golden_inputs = (
        Golden({"strain_x": 12.5, "strain_y": -0.25}, (bytes.fromhex("53 00 000030d4 ffffff06 d37ce152"),)),
        Golden(
            {"strain_x": -2147483.648, "strain_y": 2147483.647}, (bytes.fromhex("53 ff 80000000 7fffffff 983f4a74"),)
        ),
    )
    golden_outputs = (
        Golden({"voltage_x": 60.0, "voltage_y": -20.0}, (bytes.fromhex("56 2ee0 f060 c170453e"),)),
        Golden({"voltage_x": -163.84, "voltage_y": 163.835}, (bytes.fromhex("56 8000 7fff 198df1f9"),)),
    )

    def peer(self):
        return UdpPeer()
