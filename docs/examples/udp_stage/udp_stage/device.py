"""A stand-in for the amplifier, to try the driver without one: `python -m udp_stage.device`.

Each axis follows its voltage with a lag of 5 ms, 0.9 um a volt.
"""

import argparse
import math
import select
import socket
import time

from . import wire

PERIOD_NS = round(1e9 / wire.STRAIN_RATE_HZ)
WATCHDOG_NS = 20_000_000
SHARE = -math.expm1(-PERIOD_NS * 1e-6 / 5.0)


class Device:
    """One amplifier on one port; `step` does what is due."""

    def __init__(self, host="127.0.0.1", port=5005, serial_number=7):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((host, port))
        self.serial_number = serial_number
        self.listener = None
        self.counter = 0
        self.voltages_V, self.strains_um = [0.0, 0.0], [0.0, 0.0]
        self.next_ns = self.commanded_ns = time.monotonic_ns()

    def step(self):
        """Wait for a datagram until the next reading is due, and answer either."""
        if select.select([self.socket], [], [], max(0, self.next_ns - time.monotonic_ns()) * 1e-9)[0]:
            self.answer(*self.socket.recvfrom(2048))
        if time.monotonic_ns() >= self.next_ns:
            self.next_ns = max(self.next_ns + PERIOD_NS, time.monotonic_ns() - PERIOD_NS)
            self.move()
            self.report()

    def answer(self, datagram, sender):
        """Do what a datagram asks for; a damaged one is passed over."""
        if datagram[:1] == b"?" and wire.opened(datagram, wire.WHO) is not None:
            self.listener = sender
            self.tell(wire.sealed(wire.IAM.pack(b"!", self.serial_number)))
        elif datagram[:1] == b"V" and (fields := wire.opened(datagram, wire.VOLTAGES)):
            self.command([step * wire.V_PER_STEP for step in fields])

    def command(self, voltages_V):
        self.voltages_V, self.commanded_ns = voltages_V, time.monotonic_ns()

    def move(self):
        """The actuators, over one period."""
        if time.monotonic_ns() - self.commanded_ns > WATCHDOG_NS:
            self.voltages_V = [0.0, 0.0]
        for axis, voltage_V in enumerate(self.voltages_V):
            self.strains_um[axis] += SHARE * (0.9 * voltage_V - self.strains_um[axis])

    def report(self):
        steps = [round(strain_um / wire.UM_PER_STEP) for strain_um in self.strains_um]
        self.tell(wire.sealed(wire.STRAINS.pack(b"S", self.counter, *steps)))
        self.counter = (self.counter + 1) % wire.COUNTS

    def tell(self, datagram):
        if self.listener is not None:
            self.socket.sendto(datagram, self.listener)


def main():
    """Play until Ctrl-C."""
    parser = argparse.ArgumentParser(description="Plays the amplifier of the driver udp_stage until Ctrl-C.")
    parser.add_argument("--port", type=int, default=5005)
    parser.add_argument("--serial-number", type=int, default=7)
    chosen = parser.parse_args()
    device = Device(port=chosen.port, serial_number=chosen.serial_number)
    try:
        while True:
            device.step()
    except KeyboardInterrupt:
        device.socket.close()


if __name__ == "__main__":
    main()
