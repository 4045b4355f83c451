"""A hub in virtual time: what a test sees doesn't depend on how busy the machine is."""

import itertools
import os
import select
import threading

import can

from micromanip.testbus.client import HubBus
from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.hub import CanHub

BEGIN_NS = 1_000_000_000
_numbers = itertools.count()


class VirtualLoop(EventLoop):
    """Time stands still while there is something to read, and jumps to the next timer when there is nothing."""

    def __init__(self):
        super().__init__()
        self.time_ns = BEGIN_NS

    def now_ns(self):
        return self.time_ns

    def _wait(self, next_ns):
        readable = self.readable()
        for fileno in readable:
            if fileno in self._readers:
                self._readers[fileno]()
        if not readable and next_ns is not None:
            self.time_ns = max(self.time_ns, next_ns)

    def readable(self):
        return select.select(self._readers, (), (), 0)[0]


class Recorder:
    """A node that keeps what it gets: pairs of time (ns since the beginning) and frame."""

    def __init__(self):
        self.got = []

    def on_frame(self, frame, time_ns):
        self.got.append((time_ns - BEGIN_NS, frame))

    @property
    def identifiers(self):
        return [frame.identifier for _, frame in self.got]

    @property
    def times_ns(self):
        return [time_ns for time_ns, _ in self.got]


class VirtualBus:
    """A bus that runs only when it is told to, with nodes and with clients of this process."""

    def __init__(self, bitrate=1_000_000, data_bitrate=None, **options):
        self.channel = f"test-{os.getpid()}-{next(_numbers)}"
        self.loop = VirtualLoop()
        self.hub = CanHub(self.loop, self.channel, bitrate, data_bitrate, **options)
        self._clients = []

    def node(self):
        node = Recorder()
        self.hub.attach(node)
        return node

    def client(self, **options):
        """A client; it has to be greeted, so the bus runs meanwhile."""
        self.call(lambda: self._clients.append(HubBus(self.channel, **options)))
        return self._clients[-1]

    def call(self, function, step_s=0):
        """Let the bus run, in steps, while `function` waits for it in a thread; an exception there fails the test."""
        failed = []

        def caught():
            try:
                function()
            except BaseException as error:
                failed.append(error)

        thread = threading.Thread(target=caught)
        thread.start()
        while thread.is_alive():
            self.run(step_s)
            thread.join(0.0001)
        if failed:
            raise failed[0]

    def run(self, seconds):
        self.loop.run(self.loop.time_ns + round(seconds * 1e9))
        while self.loop.readable():
            self.loop.run(self.loop.time_ns)

    def close(self):
        for client in self._clients:
            client.shutdown()
        self.hub.close()
        self.loop.close()


def received(client):
    """All that waits for a client: frames, then error frames."""
    messages = []
    while (message := client.recv(0)) is not None:
        messages.append(message)
    return [m for m in messages if not m.is_error_frame], [m for m in messages if m.is_error_frame]


def message(identifier=0x100, data=b"", **about):
    return can.Message(arbitration_id=identifier, data=data, **{"is_extended_id": False, **about})


def sent_until_refused(client, limit=100):
    """Number of frames that a client got rid of, numbered in their data, and the error that ended it."""
    for count in range(limit):
        try:
            client.send(message(0x10, bytes([count])))
        except can.CanOperationError as error:
            return count, error
    return limit, None
