"""An amplifier with two outputs and two gauges: what it is told, and what it does by itself."""

import math
import random
import threading
import time
from dataclasses import dataclass

READS = ("nan", "empty", "silent", "exception", "garbage", "late", "wrong unit", "stale")
"""How readings go wrong, while what is written is taken all the same."""
LATE_S = 0.15
"""An answer that is late comes after its time."""
OUTPUTS = ("voltage_x", "voltage_y")
_UM_PER_V, _DITHER_UM = 1.2, 2e-3


@dataclass(frozen=True)
class Habits:
    """What it does by itself. `watchdog_ms` None: it keeps its values; `opening_ms`: deaf for so long once opened.

    After power-on "unknown" is the one time what it had last, the other time rest.
    """

    watchdog_ms: float | None = None
    rest_ms: float = 0.0
    latches: bool = False
    after_power_on: str = "last"
    reads_back: bool = True
    opening_ms: float = 0.0
    boot_ms: float = 0.0

    @property
    def longest_under_way_s(self):
        """Its line holds no value back for longer. One that came after its watchdog began would be a step.

        No host can prevent that, so it is asked of who plans the line (``docs/safety.md``), and not drawn.
        """
        return math.inf if self.watchdog_ms is None else 1e-4 * self.watchdog_ms


class Amplifier:
    """Its outputs move at once; each move is told to `arrivals`, those by itself as such."""

    def __init__(self, habits, arrivals):
        self.habits, self._arrivals = habits, arrivals
        self.lock = threading.RLock()
        self._volts = dict.fromkeys(OUTPUTS, 0.0)
        self._registers = dict(self._volts)
        for name in OUTPUTS:
            arrivals.add(name, 0.0, itself=True)
        self._fed_s = None  # its watchdog waits for the first command
        self._falls_from = None
        self._has_fallen = False
        self.latched = False
        self.on, self._ready_s = True, 0.0
        self.refuses = False
        self.boots = 0
        """How often it was switched on since it was made."""
        self.fails = None
        """One of `READS`."""
        self._stale = None
        self._draw = random.Random(1)

    @property
    def hears(self):
        """Whether it is switched on, and has booted."""
        return self.on and time.monotonic() >= self._ready_s

    @property
    def goes_to_rest(self):
        """Whether its watchdog has begun."""
        self.look()
        return self._falls_from is not None

    def command(self, volts):
        """Output values by name; False where it takes none of them."""
        with self.lock:
            self.look()
            if not self.hears or self.refuses or self.latched:
                return False
            self._fed_s, self._falls_from, self._has_fallen = time.monotonic(), None, False
            for name, value in volts.items():
                self._move(name, value)
                self._registers[name] = value
            return True

    def look(self):
        """Do what its watchdog does."""
        habits = self.habits
        if habits.watchdog_ms is None or self._fed_s is None or not self.on or self._has_fallen:
            return
        over_ms = (time.monotonic() - self._fed_s) * 1e3 - habits.watchdog_ms
        if over_ms <= 0.0:
            return
        self.latched = self.latched or habits.latches
        self._falls_from = self._falls_from or dict(self._volts)
        share = 1.0 if over_ms >= habits.rest_ms else over_ms / habits.rest_ms
        self._has_fallen = share == 1.0
        for name, before in self._falls_from.items():
            self._move(name, (1.0 - share) * before, itself=True)

    def feed(self):
        """A command came in time for its watchdog, if that has not begun."""
        with self.lock:
            if self._fed_s is not None and self._falls_from is None:
                self._fed_s = time.monotonic()

    def switch(self, on):
        """Switch it off, or on; without power it has 0 V."""
        with self.lock:
            if on == self.on:
                return
            self.on = on
            keeps = self.habits.after_power_on == "last" or (self.habits.after_power_on == "unknown" and self.boots % 2)
            volts = dict(self._registers) if on and keeps else dict.fromkeys(OUTPUTS, 0.0)
            if on:
                self.boots += 1
                self._registers, self._ready_s = dict(volts), time.monotonic() + self.habits.boot_ms * 1e-3
                self._fed_s, self._falls_from, self._has_fallen, self.latched = None, None, False, False
            for name in OUTPUTS:
                self._move(name, volts[name], itself=True)

    def mend(self):
        """It is on, its readings are good, it takes what is written; what is latched stays so, for a person."""
        with self.lock:
            self.switch(True)
            self.fails, self.refuses = None, False

    def rest(self):
        """A person turns its outputs to rest."""
        with self.lock:
            for name in OUTPUTS:
                self._move(name, 0.0, itself=True)
                self._registers[name] = 0.0

    def volts(self):
        """What its outputs have."""
        with self.lock:
            self.look()
            return dict(self._volts)

    def registers(self):
        """What was written last, as a device reads it back; None where it can't."""
        return dict(self._registers) if self.habits.reads_back else None

    def strains_um(self):
        """What its gauges measure, in the order of the outputs."""
        if self.fails != "stale" or self._stale is None:
            volts = self.volts()
            self._stale = [_UM_PER_V * volts[name] + self._draw.uniform(-_DITHER_UM, _DITHER_UM) for name in OUTPUTS]
        return self._stale

    def _move(self, name, value, *, itself=False):
        if itself and value == self._volts[name]:
            return
        self._arrivals.add(name, value, itself=itself)
        self._volts[name] = value if math.isfinite(value) else 0.0


class HeldBack:
    """What the line to an amplifier holds back, each with the time at which it came.

    What is `acknowledged` counts as taken, and came in time if the watchdog has not begun: this process saw it late.
    """

    def __init__(self, amplifier, *, acknowledged=False):
        self._amplifier, self.acknowledged, self._held = amplifier, acknowledged, []

    def add(self, what, came_ns):
        """One more."""
        self._held.append((self._amplifier.boots, came_ns, what))

    def arriving(self):
        """What arrives now; not what came before the device was switched on, nor what is under way for too long."""
        held, self._held = self._held, []
        least_ns = time.monotonic_ns() - 1e9 * self._amplifier.habits.longest_under_way_s
        for boots, came_ns, what in held:
            in_time = came_ns >= least_ns or (self.acknowledged and not self._amplifier.goes_to_rest)
            if in_time and boots == self._amplifier.boots:
                yield what
