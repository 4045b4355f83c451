"""What arrived at the device: each value with its time, in order, as the wire in front of the device saw it."""

import threading
import time
from dataclasses import dataclass


@dataclass(eq=False)
class Arrival:
    """One output's value on its way into the device."""

    time_ns: int
    name: str
    volts: float
    taken_ns: int | None = None
    """When the device said that it has done it; None where it has not, or never says so."""
    refused: bool = False


class Arrivals:
    """All of them since the last `forget`; written by the wire's thread."""

    def __init__(self):
        self._lock = threading.Lock()
        self._all = []
        self.count = 0

    def add(self, name, volts):
        """One more, now."""
        return self.take_up(Arrival(time.monotonic_ns(), name, volts))

    def take_up(self, arrival):
        """One more, with its own time."""
        with self._lock:
            self._all.append(arrival)
            self.count += 1
        return arrival

    def copy(self):
        """In the order of arrival."""
        with self._lock:
            return list(self._all)

    def forget(self, before_ns):
        """Keep only what is newer, and the last of each output that was not refused."""
        with self._lock:
            last = {each.name: each for each in self._all if each.time_ns < before_ns and not each.refused}
            old = sorted(last.values(), key=lambda each: each.time_ns)
            self._all = old + [each for each in self._all if each.time_ns >= before_ns]

    def volts(self):
        """Each output's newest value that was not refused."""
        return {each.name: each.volts for each in self.copy() if not each.refused}
