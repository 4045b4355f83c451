"""A device on the test bus as the conformance suite wants it: it hangs, it is switched off, what it hears is kept.

Units of the suite are frames as SocketCAN lays them out.
"""

import contextlib
import itertools
import os

from micromanip.driver.conformance import Peer
from micromanip.testbus.frame import Frame, pack, unpack

from .hub_in_thread import bench

_numbers = itertools.count()


def channel_name():
    return f"conformance-{os.getpid()}-{next(_numbers)}"


class Gate:
    """Stands between the nodes of a device and the bus: it lets nothing through while the device hangs."""

    def __init__(self, hub):
        self.hub = hub
        self.node = None
        self.silent = False
        self.heard = []

    def attach(self, node):
        self.node = node
        self.hub.attach(self)

    def detach(self, node):
        self.hub.detach(self)

    def send(self, node, frame, time_ns=None):
        return self.silent or self.hub.send(self, frame, time_ns)

    def on_frame(self, frame, time_ns):
        if not self.silent:
            self.heard.append(frame)
            self.node.on_frame(frame, time_ns)


class BusPeer(Peer):
    """A device on a bus that is there without it, as a cable is; `at` None: bus and device are one, and go together."""

    data_bitrate = None

    def __init__(self, at):
        self.at = at
        self.channel = at.channel if at else channel_name()
        self.own_bus = contextlib.ExitStack() if at is None else None
        self.gates = []
        self.busy_ns = 0

    def build(self):
        """Make the device's nodes, on gates that are returned."""
        raise NotImplementedError

    def leave(self):
        """Switch the nodes off."""
        raise NotImplementedError

    def write(self, frame):
        """What a frame writes to the outputs; None for one that doesn't."""
        raise NotImplementedError

    def start(self):
        if self.own_bus is not None:
            self.at = self.own_bus.enter_context(bench(self.channel, self.data_bitrate))
        self.gates = self.at.ask(self.build)

    def kill(self):
        if not self.gates:
            return
        self.at.ask(self.leave)
        self.gates = []
        if self.own_bus is not None:
            self.own_bus.close()

    def silence(self, silent):
        def hang():
            for gate in self.gates:
                gate.silent = silent

        self.at.ask(hang)

    def send(self, wire):
        self.at.ask(lambda: self.at.hub.send(self.gates[0], unpack(wire)))

    def heard(self):
        """Frames that reached it since the last call; each node hears the same."""

        def take():
            frames = list(self.gates[0].heard)
            for gate in self.gates:
                gate.heard.clear()
            return frames

        return self.at.ask(take)

    def received(self):
        return [pack(frame) for frame in self.heard()]

    def writes(self):
        return [write for frame in self.heard() if (write := self.write(frame)) is not None]

    def busy_s(self):
        before_ns, self.busy_ns = self.busy_ns, self.at.ask(lambda: self.at.hub.statistics.busy_ns)
        return {self.channel: (self.busy_ns - before_ns) * 1e-9}


def unit(identifier, data, **flags):
    """A frame as a unit of the suite: `data` in hexadecimal."""
    return pack(Frame(identifier, bytes.fromhex(data), **flags))


def cut(units, lengths):
    """The same frames with less data, as many bytes as one of `lengths`."""
    frames = [unpack(one) for one in units]
    return [
        pack(Frame(frame.identifier, frame.data[:length], frame.extended, frame.fd, frame.bitrate_switch))
        for frame in frames
        for length in lengths
        if length < len(frame.data)
    ]


def strange(identifiers, unknown, draw, fd=False):
    """Frames that mean nothing to who listens to `identifiers`: of others, of the other kind, and requests."""
    flags = {"fd": fd, "bitrate_switch": fd}
    frames = [Frame(identifier, draw.randbytes(draw.randrange(9)), **flags) for identifier in unknown]
    for identifier in identifiers:
        frames += [Frame(identifier, draw.randbytes(8), extended=True, **flags) for _ in range(5)]
        frames += [Frame(identifier, bytes(length), remote=True) for length in (0, 1, 8)]
        frames += [Frame(identifier, b"", **flags)]
    draw.shuffle(frames)
    return [pack(frame) for frame in frames]
