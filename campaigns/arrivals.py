"""Each move of a device's outputs, in order."""

import threading
import time
from dataclasses import dataclass


@dataclass(eq=False)
class Arrival:
    """One output's value; `itself`: the device moved without being told."""

    time_ns: int
    name: str
    volts: float
    itself: bool = False


class Arrivals:
    """Those since the last `forget`; written by the device's thread."""

    def __init__(self):
        self._lock = threading.Lock()
        self._all = []
        self.count = 0

    def add(self, name, volts, *, itself=False):
        """One more, now."""
        self.take_up(Arrival(time.monotonic_ns(), name, volts, itself))

    def take_up(self, arrival):
        """One more, with its own time."""
        with self._lock:
            self._all.append(arrival)
            self.count += 1

    def copy(self):
        """In the order of arrival."""
        with self._lock:
            return list(self._all)

    def forget(self, before_ns):
        """Keep only what is newer, and the last of each output."""
        with self._lock:
            last = {each.name: each for each in self._all if each.time_ns < before_ns}
            old = sorted(last.values(), key=lambda each: each.time_ns)
            self._all = old + [each for each in self._all if each.time_ns >= before_ns]

    def volts(self):
        """Each output's newest value."""
        return {each.name: each.volts for each in self.copy()}
