"""A device in a thread, on any of the wires; what it says and understands is for a subclass."""

import threading
import time
from types import MappingProxyType

from micromanip.driver.conformance import Peer


class LinePeer(Peer):
    """Calls `take` with what came, and `speak` every `period_s`."""

    period_s = 0.001
    framing = MappingProxyType({})

    def __init__(self, wire):
        self.wire = wire
        self.lock = threading.RLock()
        self.thread = None
        self.inputs = {}
        self.waking = threading.Event()
        self.power_on()

    def power_on(self):
        """Forget all."""
        self.silent, self.written, self.units, self.said, self.heard = False, [], [], 0, 0

    @property
    def options(self):
        return {**self.wire.options, **self.framing}

    def start(self):
        self.power_on()
        self.wire.start()
        self.on = True
        self.thread = threading.Thread(target=self.play)
        self.thread.start()

    def kill(self):
        if self.thread is not None:
            self.on = False
            self.thread.join()
            self.thread = None
            self.wire.kill()

    def play(self):
        due_s = time.monotonic()
        while self.on:
            if self.waking.is_set():
                while self.wire.read(0.0):
                    pass  # what waits in this machine's own buffers would never reach a device that hangs
                self.silent = False
                self.waking.clear()
            data = self.wire.read(max(0.0, min(0.02, due_s - time.monotonic())))
            with self.lock:
                if data:
                    self.take(data)
                if time.monotonic() >= due_s:
                    due_s = max(due_s + self.period_s, time.monotonic() - 0.01)
                    if not self.silent:
                        self.speak()

    def speak(self):
        """Say what comes by itself."""

    def take(self, data):
        """Understand what came."""

    def silence(self, silent):
        with self.lock:
            self.silent = self.silent or silent
        if not silent:
            self.waking.set()  # only the thread that reads can tell what came while it was silent
            while self.waking.is_set():
                assert self.thread.is_alive(), "the device is not switched on"
                time.sleep(0.001)

    def set_input(self, channel, value):
        self.inputs[channel] = value

    def writes(self):
        with self.lock:
            seen, self.written = self.written, []
        return seen

    def received(self):
        with self.lock:
            seen, self.units = self.units, []
        return seen

    def send(self, wire):
        with self.lock:
            self.wire.write(wire)
