"""A machine that has no memory, or no thread, left for this process: it ends in an orderly way, at once.

What would fail next, and how, nobody can say: answers to clients, the sign of life, the end itself. So a little memory
is kept for the end from the start; and where the end itself waits for a thread that can't begin, the system ends the
process: the loop takes its outputs to park without it.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from micromanip.errors import CheckFailed

_KEPT_BYTES = 16 << 20
_OBJECT_BYTES, _PER_ARENA = 448, 1000
"""Largest small objects, and at most so many of them are in an arena of Python's."""
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
"""Of ``malloc.h``."""
_AT_LATEST_S = 30
_NO_THREAD = "can't start new thread"


class Exhaustion:
    """Hears of every error that nobody expected."""

    def __init__(self, say: Callable[[str], None], end: Callable[[], None]) -> None:
        """`end` begins the orderly end."""
        self._say, self._end = say, end
        self._kept, self._arenas = _reserve()
        self.what: str | None = None
        """What there was no more of, and where; None: nothing is missing."""

    def let_go(self) -> None:
        """Let others have the memory that was kept; takes none."""
        self._kept.clear()

    def hear(self, problem: BaseException | None, where: str) -> bool:
        """Whether `problem` is one of the kind; the first one begins the end."""
        if isinstance(problem, MemoryError):
            lacks = "memory"
        elif isinstance(problem, RuntimeError) and str(problem) == _NO_THREAD:
            lacks = "threads"
        else:
            return False
        if self.what is None:
            self.let_go()
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


def _reserve() -> tuple[list[bytes | bytearray], list[bytes]]:
    """What is let go for the end, and what keeps the freed part of it this process' own.

    Where the address space is limited to far less than there is of it, the system gives back nothing that it was given.
    """
    libc = ctypes.CDLL(None)
    with contextlib.suppress(AttributeError):  # glibc's: all threads from one heap, which never shrinks
        for option, value in ((_TRIM_THRESHOLD, 1 << 30), (_MMAP_THRESHOLD, 2 * _KEPT_BYTES), (_ARENA_MAX, 1)):
            libc.mallopt(option, value)
    small = [bytes(_OBJECT_BYTES) for _ in range(_KEPT_BYTES // _OBJECT_BYTES)]
    kept: list[bytes | bytearray] = [one for number, one in enumerate(small) if number % _PER_ARENA]
    return [*kept, bytearray(_KEPT_BYTES)], small[::_PER_ARENA]


class _Threads(ThreadPoolExecutor):
    """Threads that let go of what is kept where they run out of memory: else they could not even say so, and end."""

    let_go: Callable[[], None]

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        def guarded() -> Any:
            try:
                return fn(*args, **kwargs)
            except MemoryError:
                self.let_go()
                raise

        return super().submit(guarded)


def use_threads(loop: asyncio.AbstractEventLoop, pool: ThreadPoolExecutor) -> None:
    """Make `pool` the loop's; at the end it is left without the thread that asyncio begins for that."""

    async def leave(timeout: float | None = None) -> None:  # noqa: ARG001 (asyncio's)
        pool.shutdown(wait=False)

    loop.set_default_executor(pool)
    loop.shutdown_default_executor = leave  # type: ignore[method-assign]


def begun_threads(count: int, name: str, let_go: Callable[[], None] = lambda: None) -> ThreadPoolExecutor:
    """A pool whose threads all run already: later there may be none to be had. `let_go` makes room."""
    pool, all_there = _Threads(count, name), threading.Barrier(count + 1)
    pool.let_go = let_go
    for _ in range(count):
        pool.submit(all_there.wait)
    all_there.wait()
    return pool
