"""A hub in virtual time: what a test sees doesn't depend on how busy the machine is."""

import itertools
import os
import select
import threading

from micromanip.sim.canbus.client import HubBus
from micromanip.sim.canbus.hub import CanHub
from micromanip.sim.event_loop import EventLoop

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
        readable = select.select(self._readers, (), (), 0)[0]
        for fileno in readable:
            if fileno in self._readers:
                self._readers[fileno]()
        if not readable and next_ns is not None:
            self.time_ns = max(self.time_ns, next_ns)


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
        """A client; the bus runs meanwhile, because it has to greet it."""
        opened = []
        thread = threading.Thread(target=lambda: opened.append(HubBus(self.channel, **options)))
        thread.start()
        while thread.is_alive():
            self.loop.run(self.loop.time_ns)
        thread.join()
        self._clients += opened
        return opened[0]

    def run(self, seconds):
        self.loop.run(self.loop.time_ns + round(seconds * 1e9))

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
