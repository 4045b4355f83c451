"""How many errors that come and go are a lost link."""

from __future__ import annotations

import time
from collections import deque

from .errors import BusError, LinkError

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
