"""A CAN bus in software, and a node on it that a database describes."""

import struct
import threading
import time

from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.frame import Frame
from micromanip.testbus.hub import CanHub

from .amplifier import LATE_S, OUTPUTS, HeldBack

_VOLTAGES, _SENSORS, _STRANGER = 256, 257, 300
_PERIOD_NS, _LOOK_NS = 5_000_000, 2_000_000
_V, _OFFSET_V, _UM = 0.00275, -22.0, 1e-4
_LINES = 0x7F


class CanBus:
    """A bus and what is on it, in a thread: told each frame that reaches it, asked each period what it has to say."""

    def __init__(self, amplifier, channel):
        self.amplifier, self.place = amplifier, channel
        self.frozen = threading.Lock()
        self._loop = EventLoop()
        self._hub = CanHub(self._loop, channel, 1_000_000, 5_000_000)
        self._hub.attach(self)
        self._cut, self._held, self._boots = None, HeldBack(amplifier, acknowledged=True), 0
        self.boot()
        self._loop.call_at(time.monotonic_ns(), self._say)
        self._loop.call_at(time.monotonic_ns(), self._look)
        self._thread = threading.Thread(target=self._loop.run, daemon=True)
        self._thread.start()

    def cut(self, how):
        """A bus knows one: nothing is said. The hub acknowledges each frame, as a bus that is cut does not."""
        self._cut = how

    @property
    def is_cut(self):
        return self._cut is not None

    def mend(self):
        self._cut = None

    def close(self):
        self._loop.stop()
        self._thread.join()
        self._hub.close()
        self._loop.close()

    def on_frame(self, frame, time_ns):
        """One of the bus, which this process may see late."""
        if not frame.error and self.amplifier.hears:
            self._held.add(frame, time_ns)
            if not self.frozen.locked():
                self._hear_held()

    def send(self, frame):
        """Onto the bus, if it can."""
        if self.amplifier.hears and self._cut is None:
            self._hub.send(self, frame)

    def send_reading(self, frame):
        """The same; one that fails by being late comes so."""
        late_ns = round(LATE_S * 1e9) if self.amplifier.fails == "late" else 0
        self._loop.call_at(time.monotonic_ns() + late_ns, lambda: self.send(frame))

    def _look(self):
        self._loop.call_at(time.monotonic_ns() + _LOOK_NS, self._look)
        if self.frozen.locked():
            return
        with self.amplifier.lock:
            self.amplifier.look()
            self._hear_held()

    def _hear_held(self):
        if self.amplifier.boots != self._boots and self.amplifier.hears:
            self._boots = self.amplifier.boots
            self.boot()
        for frame in self._held.arriving():
            self.hear(frame)

    def _say(self):
        self._loop.call_at(time.monotonic_ns() + _PERIOD_NS, self._say)
        if self.amplifier.hears and not self.frozen.locked():
            self.say()


class CanNode(CanBus):
    """Sends its readings 200 times a second; frames are those of config/can/manipulator.dbc."""

    def boot(self):
        """Its counter begins anew."""
        self._count = 0

    def hear(self, frame):
        """Take voltages."""
        if frame.identifier == _VOLTAGES:
            codes = struct.unpack_from("<HH", frame.data)
            volts = {name: round(_V * code + _OFFSET_V, 6) for name, code in zip(OUTPUTS, codes, strict=True)}
            self.amplifier.command(volts)

    def say(self):
        """A frame with readings."""
        fails = self.amplifier.fails
        if fails == "silent" or self._cut is not None:
            return
        if fails != "stale":
            self._count = (self._count + 1) % 65536
        codes = [round(value / _UM) for value in self.amplifier.strains_um()]
        if fails == "nan":
            codes = [2**23 - 1] * 2
        body = b"".join(code.to_bytes(3, "little", signed=True) for code in codes) + bytes(12)
        status = int(fails in ("exception", "garbage"))
        data = body + bytes((status, _LINES, 0, 0)) + self._count.to_bytes(2, "little")
        self.send_reading(
            Frame(_STRANGER if fails == "wrong unit" else _SENSORS, b"" if fails == "empty" else data, fd=True)
        )
