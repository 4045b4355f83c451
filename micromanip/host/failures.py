"""Errors that nobody expected, in the host: a task that fails ends the run, a machine without memory the process.

Without memory, or a thread to be had, nobody can say what fails next: answers to clients, the sign of life, the end
itself. So the process ends at once, and the loop takes its outputs to park without it, as after any death of the host.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from typing import Any

from micromanip.errors import CheckFailed

_LAST_WORDS = b"WARNING: the host is out of memory or threads: it ends, the loop takes the outputs to park\n"
_NO_THREAD = "can't start new thread"


class Failures:
    """Hears of each of them."""

    def __init__(self, end: Callable[[], None]) -> None:
        """`end` begins the orderly end."""
        self._end = end
        self.what: str | None = None
        """What ended the run; None: nothing did."""

    def hear(self, problem: BaseException | None) -> None:
        """End the process where it lacks memory or threads; nothing is taken for that."""
        if isinstance(problem, MemoryError) or (isinstance(problem, RuntimeError) and str(problem) == _NO_THREAD):
            os.write(2, _LAST_WORDS)
            os._exit(1)

    def unhandled(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """What the event loop calls with an error that nobody took."""
        self.hear(context.get("exception"))
        loop.default_exception_handler(context)

    def watch(self, task: asyncio.Task[None]) -> None:
        """End the run where a task that lasts as long fails: nobody does its work any more."""

        def done(task: asyncio.Task[None]) -> None:
            if not task.cancelled() and (problem := task.exception()) is not None:
                self.hear(problem)
                self.what = self.what or f"bug: {task.get_name()} failed: {type(problem).__name__}: {problem}"
                self._end()

        task.add_done_callback(done)

    def judge(self) -> None:
        """Raise CheckFailed where a task has failed."""
        if self.what is not None:
            raise CheckFailed(self.what)
