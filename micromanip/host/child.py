"""A child process of the host: started by exec in a session of its own, ordered on its standard input, heard by line.

Loop, driver workers, recorder and black box are all children like that. A session of its own keeps Ctrl-C in the
terminal from them: the host ends them in order, by closing their standard input or by what they read in the shared
memory, and kills those that do not obey. Orders and answers are JSON, one document a line.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from typing import Any

from micromanip.bus.backoff import RestartLimit

from .shared_memory import send_orders

_RESTART_S = 1.0
_RESTARTS, _WITHIN_S = 3, 600.0
"""One is started again so often within that time: what dies by each trip, say, must not keep a CPU busy."""


class Child:
    """One role, by the module that plays it; after a restart the same object stands for the new process."""

    def __init__(
        self,
        module: str,
        descriptors: Sequence[int] = (),
        *,
        complains: bool = False,
    ) -> None:
        """`descriptors` are inherited; `complains`: its standard error is ours, too, as its standard output is."""
        self._module, self._descriptors = module, tuple(descriptors)
        self._error = PIPE if complains else None
        self._process: Process | None = None
        self._wire: socket.socket | None = None
        self.starts = 0

    async def start(self, orders: Any) -> None:
        """Start a process and give it its orders."""
        await self._execute(PIPE)
        self.send(orders)

    async def begin(self) -> None:
        """Start a process that gets all its orders later, by `send_orders`: it imports meanwhile."""
        self._wire, standard_input = socket.socketpair()
        with standard_input:
            await self._execute(standard_input)

    async def _execute(self, standard_input: Any) -> None:
        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            *("-P", "-m", self._module),  # -P: the folder where we were started is no place for our modules
            stdin=standard_input,
            stdout=PIPE,
            stderr=self._error,
            pass_fds=self._descriptors,
            start_new_session=True,
        )
        self.starts += 1

    def send_orders(self, orders: Any, descriptors: Sequence[int]) -> None:
        """The orders of one that was begun, with more descriptors; one that is dead is not told."""
        assert self._wire is not None
        with self._wire, contextlib.suppress(ConnectionError):
            send_orders(self._wire, orders, descriptors)

    async def let_go(self) -> None:
        """End one that was begun, if it got no orders."""
        if self._wire is not None and self._wire.fileno() >= 0:
            self._wire.close()
            self.kill()
            if self._process is not None:
                await self._process.communicate()

    async def keep_alive(
        self, follow: Callable[[], Awaitable[None]], is_over: Callable[[], bool], say: Callable[[str], None], name: str
    ) -> bool:
        """Have `follow` start it and return at its end, again and again; False once that was too often.

        True as soon as nobody needs it, which `is_over` says; `say` gets of the `name` that it died.
        """
        limit = RestartLimit(_RESTARTS, _WITHIN_S)
        while True:
            await follow()
            if is_over():
                return True
            if not limit.allows(time.monotonic()):
                return False
            say(f"WARNING: the {name} process died; it is started again")
            await asyncio.sleep(_RESTART_S)
            if is_over():
                return True

    @property
    def runs(self) -> bool:
        """Whether it was started and has not ended."""
        return self._process is not None and self._process.returncode is None

    @property
    def pid(self) -> int:
        """Number of the process that was started last."""
        assert self._process is not None
        return self._process.pid

    @property
    def code(self) -> int | None:
        """How it ended: its exit code, negative for a signal; None as long as it runs, or was never started."""
        return None if self._process is None else self._process.returncode

    @property
    def was_killed(self) -> bool:
        """Whether a signal ended it."""
        return self.code is not None and self.code < 0

    @property
    def end(self) -> str:
        """How it ended, in words."""
        code = self.code
        return f"was killed by signal {-code}" if code is not None and code < 0 else f"ended with {code}"

    def send(self, document: Any) -> None:
        """One more order; one that is dead, or told to end, is not told."""
        stream = None if self._process is None else self._process.stdin
        if stream is not None and not stream.is_closing():
            with contextlib.suppress(ConnectionError):
                stream.write(json.dumps(document).encode() + b"\n")

    def end_orders(self) -> None:
        """Close its standard input: it is to end in its own way."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()

    async def answers(self) -> AsyncIterator[dict[str, Any]]:
        """What it says, until it says no more; what a kill has cut off is left out."""
        assert self._process is not None
        assert self._process.stdout is not None
        async for line in self._process.stdout:
            with contextlib.suppress(ValueError):
                yield json.loads(line)

    async def complaints(self) -> AsyncIterator[str]:
        """The same line by line, as they come."""
        assert self._process is not None
        assert self._process.stderr is not None
        async for line in self._process.stderr:
            yield line.decode(errors="replace").rstrip("\n")

    async def complaint(self) -> str:
        """All that it says on standard error until its end."""
        assert self._process is not None
        assert self._process.stderr is not None
        return (await self._process.stderr.read()).decode(errors="replace")

    def kill(self) -> None:
        """End it at once."""
        if self.runs and self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()

    async def wait(self, within_s: float | None = None) -> bool:
        """Wait for its end; False where it still runs after `within_s`."""
        assert self._process is not None
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._process.wait(), within_s)
        return not self.runs


def loop_process() -> Child:
    """That of the loop, not started yet."""
    return Child("micromanip.host.loop_process", complains=True)
