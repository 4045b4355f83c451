"""The compiled functions at one end of a pair of sockets that carries CAN frames as the kernel has them."""

import contextlib
import ctypes
import select
import socket
import time

import numpy as np
from can.interfaces.socketcan.socketcan import build_can_frame
from micromanip_drivers.canbus import exchange
from micromanip_drivers.canbus.driver import CanBus
from micromanip_drivers.canbus.tables import Tables

from micromanip.rt.steady.records import INBOX

_FUNCTION = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64
)


def call(function, *arguments):
    """One of the two functions, as the worker's loop calls it; what it returns."""
    return _FUNCTION(function.address)(*arguments)


class Compiled:
    """Messages that are received and sent, and the wire's other end."""

    def __init__(self, received, sent, ends, silence_ns=None):
        self.tables = Tables(received, sent, True, silence_ns)
        self.inbox = np.zeros(1, INBOX)
        self.near, self.far = ends
        self.tables.hold(self.near.fileno(), 0, time.monotonic_ns())

    def receive(self, began_ns=None):
        """Take what is there; what the function says."""
        began_ns = time.monotonic_ns() if began_ns is None else began_ns
        return call(exchange.receive_c, self.tables.record.ctypes.data, 0, self.inbox.ctypes.data, began_ns, 0)

    def send(self, values, task=0):
        """Send `values` by one task; what the function says."""
        values = np.array(values, float)
        return call(exchange.send_c, self.tables.record.ctypes.data, values.ctypes.data, 0, time.monotonic_ns(), task)

    def arrives(self, message):
        """Put a frame of python-can on the wire."""
        self.far.send(build_can_frame(message))

    def heard(self):
        """The frame that was sent, as the kernel has it; None for none."""
        try:
            return self.far.recv(256)
        except BlockingIOError:
            return None

    def samples(self, count):
        """The values of the first `count` inputs."""
        return self.inbox[0]["signal"]["value"][:count].tolist()


@contextlib.contextmanager
def compiled(received=(), sent=(), silence_ns=None):
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with near, far:
        near.setblocking(False)
        far.setblocking(False)
        yield Compiled(received, sent, (near, far), silence_ns)


class CompiledCanBus(CanBus):
    """The driver whose compiled functions do all that they can, and Python what these leave, as in a worker."""

    def __init__(self, options, folder):
        super().__init__(options, folder)
        self.functions, self.samples = self.steady(), np.zeros(1, INBOX)

    def perform(self, task, values, inbox):
        values = np.array(values, float)
        context = self.functions.context.ctypes.data
        if call(exchange.send_c, context, values.ctypes.data, 0, time.monotonic_ns(), task) == 0:
            return None
        return super().perform(task, values.tolist(), inbox)

    def receive(self, inbox, until_ns):
        if self.functions.fileno() < 0:
            super().receive(inbox, until_ns)
            return
        began_ns = time.monotonic_ns()
        select.select([self.functions.fileno()], [], [], max(0, until_ns - began_ns) * 1e-9)
        samples = self.samples[0]
        before, lost = samples["signal"]["sequence"].copy(), int(samples["lost"])
        code = call(exchange.receive_c, self.functions.context.ctypes.data, 0, self.samples.ctypes.data, began_ns, 0)
        ahead = samples["signal"]["sequence"] - before
        missing = (int(samples["lost"]) - lost) // len(self.inputs)  # all of one message
        for i in np.flatnonzero(ahead):
            signal = samples["signal"][i]
            inbox.put(int(i), float(signal["value"]), int(signal["time_ns"]), int(signal["status"]), missing)
        if code != 0:
            super().receive(inbox, time.monotonic_ns())
