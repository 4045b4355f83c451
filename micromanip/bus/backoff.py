"""When errors are a lost link, how long to wait before it is tried again, when a process has been started too often."""

from __future__ import annotations

import random
import time
from collections import deque

from .errors import BusError, LinkError

_FIRST_S, _LONGEST_S, _STABLE_S = 0.05, 2.0, 1.0
_JITTER = 0.2


class BackOff:
    """50 ms after the first loss, twice as long after each further one, 2 s at most; forgotten once a link has held."""

    def __init__(self, draw: random.Random | None = None) -> None:
        self._draw = draw or random.Random()
        self._tries = 0

    def lost(self, held_s: float) -> float:
        """Seconds to wait now that a link, or a try to get one, is over after `held_s`."""
        if held_s >= _STABLE_S:
            self._tries = 0
        wait_s = min(_LONGEST_S, _FIRST_S * 2.0**self._tries)
        self._tries = min(self._tries + 1, 16)
        # several workers that lost the same bus don't come back in step
        return wait_s * (1.0 + _JITTER * (2.0 * self._draw.random() - 1.0))


class RestartLimit:
    """Five restarts in a minute are enough: what always fails again is not tried for ever."""

    def __init__(self, restarts: int = 5, within_s: float = 60.0) -> None:
        self._times: deque[float] = deque(maxlen=restarts)
        self._within_s = within_s

    def allows(self, now_s: float) -> bool:
        """Note a restart at `now_s`; False where there have been too many."""
        full = len(self._times) == self._times.maxlen and now_s - self._times[0] < self._within_s
        if not full:
            self._times.append(now_s)
        return not full


_ERRORS, _AMONG = 10, 40
"""So many errors among the last calls are a lost link."""


class Patience:
    """Remembers how the last calls of a driver went, since its link has come up."""

    def __init__(self) -> None:
        self._failed: deque[bool] = deque(maxlen=_AMONG)
        self._good_ns = time.monotonic_ns()

    def note(self, failed: bool, calls: int, now_ns: int) -> None:
        """So many calls, up to `now_ns`, that went well or not."""
        self._failed.extend([failed] * min(calls, _AMONG))
        if sum(self._failed) < _ERRORS - 1:
            self._good_ns = now_ns

    def judge(self, problem: BusError, patience_ns: int) -> None:
        """Raises LinkError where `problem` is one of too many, for longer than `patience_ns`."""
        impatient = time.monotonic_ns() - self._good_ns >= patience_ns
        if impatient and sum(self._failed) >= _ERRORS - 1:
            raise LinkError(f"{_ERRORS} errors in the last {_AMONG} calls; the last: {problem}") from problem
