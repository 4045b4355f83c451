"""A test bus that runs beside the test; what concerns it is done in its own thread."""

import contextlib
import queue

from testbus.loop_in_thread import LoopInThread

from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.frame import Frame
from micromanip.testbus.hub import CanHub

BITRATE, DATA_BITRATE = 1_000_000, 5_000_000


class Device:
    """A node that keeps what it hears."""

    def __init__(self):
        self.heard = queue.SimpleQueue()

    def on_frame(self, frame, time_ns):
        self.heard.put((frame, time_ns))


class Bench:
    def __init__(self, loop, channel, data_bitrate):
        self.channel, self.loop = channel, loop
        self.hub = CanHub(loop, channel, BITRATE, data_bitrate)
        self.device = Device()
        self.hub.attach(self.device)
        self._running = LoopInThread(loop)
        self.do, self.ask = self._running.do, self._running.ask

    def send(self, identifier, data, **flags):
        self.do(lambda: self.hub.send(self.device, Frame(identifier, data, **flags)))

    def inject(self, fault):
        self.do(lambda: self.hub.faults.inject(fault))

    def close(self):
        self._running.end()
        self.hub.close()
        self.loop.close()


@contextlib.contextmanager
def bench(channel, data_bitrate=DATA_BITRATE):
    with contextlib.closing(Bench(EventLoop(), channel, data_bitrate)) as at:
        yield at
