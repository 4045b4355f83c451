"""A framing at one end of a pair of sockets: in Python alone, or with its compiled functions in front."""

import os
import socket
import termios
import time

import numpy as np
from micromanip_drivers.line.binary import BinaryFraming
from micromanip_drivers.line.driver import Line
from micromanip_drivers.line.framing import LineTime, Silence
from micromanip_drivers.line.options import SerialPort
from micromanip_drivers.line.port import Port

from micromanip.bus.errors import TransientError
from micromanip.bus.inbox import Inbox
from micromanip.rt.io.worker_records import INBOX

from ..compiled_turns import CompiledTurns, call_receive, call_send

SILENCE_MS = 100_000.0


class PairPort(Port):
    """A port with its other end."""

    waiting_request = termios.TIOCOUTQ
    is_plain = True

    def __init__(self):
        super().__init__("the device")
        self.near, self.far = socket.socketpair()
        self.near.setblocking(False)
        self.far.setblocking(False)

    def _connect(self, deadline_ns):
        return self.near.fileno()

    def _disconnect(self):
        pass

    def _read(self, descriptor):
        if not (data := os.read(descriptor, self.largest)):
            raise ConnectionResetError("the other end is gone")
        return data, time.monotonic_ns()

    def _write(self, descriptor, data):
        return os.write(descriptor, data)


class Spoken:
    """Framing and port of `options`, the table of samples as the loop would see it, and how many errors there were."""

    def __init__(self, options, compiled, kind=BinaryFraming):
        self.port = PairPort()
        self.framing = kind(
            options, self.port, LineTime(SerialPort(device="/dev/a", baud=9600)), Silence("the device", SILENCE_MS)
        )
        self.steady = self.framing.steady() if compiled else None
        assert (self.steady is not None) == compiled
        self.inbox, self.errors = np.zeros(1, INBOX), 0
        self.port.open(0)

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        self.port.near.close()
        self.port.far.close()

    @property
    def record(self):
        return self.steady.context[0]

    def begin(self, first):
        """The device is there: it says `first`."""
        self.port.far.send(first)
        self.framing.begin(time.monotonic_ns() + 10**10)

    def receive_compiled(self):
        """What the function says."""
        return call_receive(self.steady, self.inbox)

    def receive(self):
        """Take what is there as a worker does: compiled as far as that goes; what that said."""
        code = self.receive_compiled() if self.steady else 1
        if code != 0:
            self.receive_in_python()
        return code

    def receive_in_python(self):
        inbox, signal = Inbox(), self.inbox[0]["signal"]
        try:
            self.framing.receive(inbox, 0)
        except TransientError:
            self.errors += 1
        for sample in inbox:
            row = signal[sample.channel]
            row["value"], row["time_ns"], row["status"] = sample.value, sample.time_ns, sample.status
            row["sequence"] += 1 + sample.lost
            self.inbox[0]["missing"][sample.channel] += sample.lost

    def arrives(self, chunk):
        """It comes in one piece, and is taken."""
        self.port.far.send(chunk)
        return self.receive()

    def send(self, values, task=0):
        """What the function says."""
        return call_send(self.steady, values, task)

    def heard(self):
        """The bytes that were sent; empty for none."""
        try:
            return self.port.far.recv(65536)
        except BlockingIOError:
            return b""


class CompiledLine(CompiledTurns, Line):
    """The driver by its compiled functions, as far as they go."""
