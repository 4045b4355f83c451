"""The framing `binary` at one end of a pair of sockets: in Python alone, or with its compiled functions in front."""

import ctypes
import os
import select
import socket
import termios
import time

import numpy as np
from micromanip_drivers.line import exchange
from micromanip_drivers.line.binary import BinaryFraming
from micromanip_drivers.line.driver import Line
from micromanip_drivers.line.framing import Silence
from micromanip_drivers.line.line_time import LineTime
from micromanip_drivers.line.port import Port
from micromanip_drivers.line.port_options import SerialPort

from micromanip.bus.driver import Inbox, Outcome
from micromanip.bus.errors import TransientError
from micromanip.rt.steady.records import INBOX, UNCONFIRMED

SILENCE_MS = 100_000.0
_FUNCTION = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64
)


def call(function, *arguments):
    """One of the two functions, as the worker's loop calls it; what it returns."""
    return _FUNCTION(function.address)(*arguments)


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

    def __init__(self, options, compiled):
        self.port = PairPort()
        self.framing = BinaryFraming(
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
        return call(exchange.receive_c, self.steady.context.ctypes.data, 0, self.inbox.ctypes.data, 0, 0)

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

    def arrives(self, chunk):
        """It comes in one piece, and is taken."""
        self.port.far.send(chunk)
        return self.receive()

    def send(self, values, task=0):
        """What the function says."""
        values = np.array(values, float)
        return call(exchange.send_c, self.steady.context.ctypes.data, values.ctypes.data, 0, 0, task)

    def heard(self):
        """The bytes that were sent; empty for none."""
        try:
            return self.port.far.recv(65536)
        except BlockingIOError:
            return b""


class CompiledLine(Line):
    """The driver whose compiled functions do all that they can, and Python what these leave, as in a worker."""

    def __init__(self, options, folder):
        super().__init__(options, folder)
        self.functions, self.samples = self.steady(), np.zeros(1, INBOX)
        assert self.functions is not None

    def perform(self, task, values, inbox):
        values = np.array(values, float)
        if self.functions.fileno() < 0:
            return super().perform(task, values.tolist(), inbox)
        context = self.functions.context.ctypes.data
        code = call(exchange.send_c, context, values.ctypes.data, 0, time.monotonic_ns(), task)
        if code == 0:
            return None
        return Outcome.SENT if code == UNCONFIRMED else super().perform(task, values.tolist(), inbox)

    def receive(self, inbox, until_ns):
        if self.functions.fileno() < 0:
            super().receive(inbox, until_ns)
            return
        began_ns = time.monotonic_ns()
        select.select([self.functions.fileno()], [], [], max(0, until_ns - began_ns) * 1e-9)
        samples = self.samples[0]
        before, lost = samples["signal"]["sequence"].copy(), int(samples["lost"])
        samples["confirmed"] = 0
        code = call(exchange.receive_c, self.functions.context.ctypes.data, 0, self.samples.ctypes.data, began_ns, 0)
        ahead = samples["signal"]["sequence"] - before
        missing = (int(samples["lost"]) - lost) // len(self.inputs)  # all of one message
        for i in np.flatnonzero(ahead):
            signal = samples["signal"][i]
            inbox.put(int(i), float(signal["value"]), int(signal["time_ns"]), int(signal["status"]), missing)
        for task in np.flatnonzero(samples["confirmed"]):
            inbox.confirm(int(task))
        if code != 0:
            super().receive(inbox, time.monotonic_ns())
