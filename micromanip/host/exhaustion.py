"""A machine that has no memory, or no thread, left for this process: it ends in an orderly way, at once.

What would fail next, and how, nobody can say: answers to clients, the sign of life, the end itself. So a little memory
is kept for the end from the start; and where the end itself waits for a thread that can't begin, the system ends the
process: the loop takes its outputs to park without it.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from micromanip.errors import CheckFailed

_KEPT_BYTES = 16 << 20
_AT_LATEST_S = 30
_NO_THREAD = "can't start new thread"


class Exhaustion:
    """Hears of every error that nobody expected."""

    def __init__(self, say: Callable[[str], None], end: Callable[[], None]) -> None:
        """`end` begins the orderly end."""
        self._say, self._end = say, end
        self._kept = bytearray(_KEPT_BYTES)
        self.what: str | None = None
        """What there was no more of, and where; None: nothing is missing."""

    def hear(self, problem: BaseException | None, where: str) -> bool:
        """Whether `problem` is one of the kind; the first one begins the end."""
        if isinstance(problem, MemoryError):
            lacks = "memory"
        elif isinstance(problem, RuntimeError) and str(problem) == _NO_THREAD:
            lacks = "threads"
        else:
            return False
        if self.what is None:
            self._kept = bytearray()
            signal.alarm(_AT_LATEST_S)
            self.what = f"the host is out of {lacks} ({where}): it ends, the outputs go to park"
            self._end()
            with contextlib.suppress(Exception):
                self._say(f"WARNING: {self.what}")
        return True

    def unhandled(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """What the event loop calls with an error that nobody took."""
        if not self.hear(context.get("exception"), str(context.get("message"))):
            loop.default_exception_handler(context)

    def watch(self, task: asyncio.Task[None]) -> None:
        """End, too, where a task that lasts as long as the run fails: nobody does its work any more."""

        def done(task: asyncio.Task[None]) -> None:
            if not task.cancelled() and (problem := task.exception()) is not None:
                if not self.hear(problem, task.get_name()) and self.what is None:
                    self.what = f"bug: {task.get_name()} failed: {type(problem).__name__}: {problem}"
                self._end()

        task.add_done_callback(done)

    def judge(self) -> None:
        """Raise CheckFailed where something was missing."""
        if self.what is not None:
            raise CheckFailed(self.what)


def begun_threads(count: int, name: str) -> ThreadPoolExecutor:
    """A pool whose threads all run already: later there may be none to be had."""
    pool, all_there = ThreadPoolExecutor(count, name), threading.Barrier(count + 1)
    for _ in range(count):
        pool.submit(all_there.wait)
    all_there.wait()
    return pool
