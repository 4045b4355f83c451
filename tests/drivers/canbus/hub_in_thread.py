"""A test bus that runs beside the test; what concerns it is done in its own thread."""

import contextlib
import os
import queue
import threading

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
        self._calls = queue.SimpleQueue()
        self._bell = os.eventfd(0, os.EFD_NONBLOCK)
        loop.add_reader(self._bell, self._serve)

    def do(self, call):
        """Have `call` made by the bus's thread."""
        self._calls.put(call)
        os.eventfd_write(self._bell, 1)

    def ask(self, call):
        """Have `call` made by the bus's thread, and wait for what it returns."""
        answer = queue.SimpleQueue()
        self.do(lambda: answer.put(call()))
        return answer.get(timeout=5.0)

    def send(self, identifier, data, **flags):
        self.do(lambda: self.hub.send(self.device, Frame(identifier, data, **flags)))

    def inject(self, fault):
        self.do(lambda: self.hub.faults.inject(fault))

    def close(self):
        self.hub.close()
        os.close(self._bell)

    def _serve(self):
        os.eventfd_read(self._bell)
        while not self._calls.empty():
            self._calls.get()()


@contextlib.contextmanager
def bench(channel, data_bitrate=DATA_BITRATE):
    loop = EventLoop()
    at = Bench(loop, channel, data_bitrate)
    thread = threading.Thread(target=loop.run)
    thread.start()
    try:
        yield at
    finally:
        loop.stop()
        thread.join()
        at.close()
        loop.close()
