"""A node on a CAN bus in software: sends its readings 200 times a second, takes frames with voltages."""

import struct
import threading
import time

from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.frame import Frame
from micromanip.testbus.hub import CanHub

from .amplifier import LATE_S, OUTPUTS

_VOLTAGES, _SENSORS, _STRANGER = 256, 257, 300
_PERIOD_NS, _LOOK_NS = 5_000_000, 2_000_000
_V, _OFFSET_V, _UM = 0.00275, -22.0, 1e-4
_LINES = 0x7F


class CanNode:
    """Bus and node, in a thread; frames are those of config/can/manipulator.dbc."""

    def __init__(self, amplifier, channel):
        self.amplifier, self.place = amplifier, channel
        self.frozen = threading.Lock()
        self._loop = EventLoop()
        self._hub = CanHub(self._loop, channel, 1_000_000, 5_000_000)
        self._hub.attach(self)
        self._cut, self._held, self._count, self._boots = None, [], 0, 0
        self._loop.call_at(time.monotonic_ns(), self._say)
        self._loop.call_at(time.monotonic_ns(), self._look)
        self._thread = threading.Thread(target=self._loop.run, daemon=True)
        self._thread.start()

    def cut(self, how):
        """Of the cuts of a port a bus knows: nothing is heard, it is heard late, or nothing is said."""
        self.mend()
        self._cut = how

    def mend(self):
        self._cut = None

    def close(self):
        self._loop.stop()
        self._thread.join()
        self._hub.close()
        self._loop.close()

    def on_frame(self, frame, time_ns):
        """One of the bus."""
        with self.frozen:
            if frame.identifier == _VOLTAGES and not frame.error and self.amplifier.hears:
                if self._cut == "late":
                    self._held.append((frame, time.monotonic()))
                elif self._cut in (None, "deaf"):
                    self._take(frame)

    def _take(self, frame):
        codes = struct.unpack_from("<HH", frame.data)
        volts = {name: round(_V * code + _OFFSET_V, 6) for name, code in zip(OUTPUTS, codes, strict=True)}
        self.amplifier.command(volts)

    def _look(self):
        self._loop.call_at(time.monotonic_ns() + _LOOK_NS, self._look)
        with self.frozen, self.amplifier.lock:
            self.amplifier.look()
            if self.amplifier.boots != self._boots:
                self._boots, self._count, self._held = self.amplifier.boots, 0, []
            if self._cut is None and self._held:
                held, self._held = self._held, []
                for frame, came_s in held:
                    if time.monotonic() - came_s <= self.amplifier.habits.longest_under_way_s:
                        self._take(frame)

    def _say(self):
        self._loop.call_at(time.monotonic_ns() + _PERIOD_NS, self._say)
        fails = self.amplifier.fails
        if not self.amplifier.hears or self._cut is not None or fails == "silent" or self.frozen.locked():
            return
        if fails != "stale":
            self._count = (self._count + 1) % 65536
        codes = [round(value / _UM) for value in self.amplifier.strains_um()]
        if fails == "nan":
            codes = [2**23 - 1] * 2
        body = b"".join(code.to_bytes(3, "little", signed=True) for code in codes) + bytes(12)
        status = int(fails in ("exception", "garbage"))
        data = body + bytes((status, _LINES, 0, 0)) + self._count.to_bytes(2, "little")
        frame = Frame(_STRANGER if fails == "wrong unit" else _SENSORS, b"" if fails == "empty" else data, fd=True)
        late_ns = round(LATE_S * 1e9) if fails == "late" else 0
        self._loop.call_at(time.monotonic_ns() + late_ns, lambda: self._hub.send(self, frame))
