"""The compiled functions at one end of a pair of sockets that carries CAN frames as the kernel has them."""

import contextlib
import socket
import time

import numpy as np
from can.interfaces.socketcan.socketcan import build_can_frame
from micromanip_drivers.canbus import exchange
from micromanip_drivers.canbus.driver import CanBus
from micromanip_drivers.canbus.tables import MessageTables

from micromanip.bus.driver import Steady
from micromanip.rt.io.worker_records import INBOX

from ..compiled_turns import CompiledTurns, call_receive, call_send


class Compiled:
    """Messages that are received and sent, and the wire's other end."""

    def __init__(self, received, sent, ends, silence_ns=None):
        self.tables = MessageTables(received, sent, True, silence_ns)
        self.functions = Steady(*exchange.ENTRIES.addresses, self.tables.record, lambda: self.near.fileno())
        self.inbox = np.zeros(1, INBOX)
        self.near, self.far = ends
        self.tables.hold(self.near.fileno(), 0, time.monotonic_ns())

    def receive(self, began_ns=None):
        """Take what is there; what the function says."""
        began_ns = time.monotonic_ns() if began_ns is None else began_ns
        return call_receive(self.functions, self.inbox, began_ns)

    def send(self, values, task=0):
        """Send `values` by one task; what the function says."""
        return call_send(self.functions, values, task)

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


class CompiledCanBus(CompiledTurns, CanBus):
    """The driver by its compiled functions, as far as they go."""
