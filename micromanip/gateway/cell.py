"""The controller as the gateway sees it: its telemetry mapped for reading, its status, asked for; orders, passed on.

The gateway outlives controllers: where one goes away its last figures are not shown any longer, and the next one begins
a history of its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import mmap
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.client import Client
from micromanip.errors import CheckFailed, MicromanipError
from micromanip.host.shared_memory import CONTROL, RING, STATUS, RingReader, columns
from micromanip.replies import Telemetry
from micromanip.rt.telemetry import ROW
from micromanip.status_reply import Status

from .fields import fields
from .history import History

_LOOK_S = 0.25
_TAIL_S = 0.025
_SILENT_S = 0.1
"""A ring without a new row for so long: the loop may have died, which only the host can say, so it is asked at once."""
_AGAIN_S = 0.5
_MOST_ROWS, _MOST_READS = 4096, 16
_SPARE_ROWS = 1 << 15
"""How far behind the oldest row the reading of a new ring begins: the loop goes on meanwhile, 3 s at 10 kHz."""
_MEMORIES = (STATUS, RING, CONTROL)
"""In the order in which their descriptors come."""

Rows = NDArray[Any]


class Source:
    """The telemetry of one controller: its history, and its ring."""

    def __init__(
        self, about: Telemetry, status: Any, ring: Any, control: Any, inode: int, history: History | None = None
    ) -> None:
        """Records of `STATUS`, `RING` and `CONTROL`; `inode` is that of the ring's memory.

        `history` is that of a controller before, with as many axes, whose memory is used again.
        """
        self.about, self.status, self.inode = about, status, inode
        self.parameters = control["parameters"]
        self.fields = fields(about["axes"])
        self.history = History(self.fields) if history is None else history
        self.reader = RingReader(ring)
        self._is_new = True
        self.latest: Any | None = None

    def so_far(self) -> dict[str, Any]:
        """What a frame says of a recording; of what runs, nothing."""
        return {}

    def read(self) -> Rows | None:
        """New rows, which are in the history then; None where there are none."""
        if self._is_new:  # what is still in the ring from before we came
            self.history.clear()
            self.reader.go_back(0, _SPARE_ROWS)
            self._is_new = False
        rows = self.reader.read(_MOST_ROWS)
        if not len(rows):
            return None
        self.history.add(rows)
        self.latest = rows[-1]
        return rows


class Cell:
    """Follows the controller on one control socket, as long as `follow` runs."""

    def __init__(self, socket: Path) -> None:
        self.socket = socket
        self.source: Source | None = None
        self.status: Status | None = None
        self.unseen: dict[str, Any] | None = None
        """Faults and black boxes, as a status has them, of a controller that is gone, until they were `seen`."""
        self._latched: tuple[int, dict[str, Any]] | None = None
        self.problem: str | None = "not asked yet"
        """Why there is no status."""
        self.heard_s = 0.0
        """When the last status came, CLOCK_MONOTONIC."""
        self.listeners: set[Callable[[Rows | None], None]] = set()
        """Each hears of new rows, and with None of a new status."""
        self._client: Client | None = None
        self._wake = asyncio.Event()
        self._threads = ThreadPoolExecutor(4, "control")

    async def follow(self) -> None:
        """As long as it runs: read the ring, and ask for the status."""
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._tail())
                tasks.create_task(self._look())
        finally:
            self._threads.shutdown(wait=False, cancel_futures=True)
            if self._client is not None:
                self._client.close()

    async def order(self, verb: str, name: str, **fields: Any) -> Any:
        """Ask for `verb` in the name of a token; what the controller answers, or raises."""

        def send() -> Any:
            with Client(self.socket, on_behalf_of=name) as client:
                return client.request(verb, **fields)

        answer = await self._in_thread(send)
        self._wake.set()
        return answer

    def take(self, status: Status | None) -> None:
        """A new status, None where no controller answers; what was latched in one that is gone stays to be seen."""
        self.status, ring = status, self.source.inode if self.source is not None else 0
        if self._latched is not None and (status is None or ring != self._latched[0]):
            self.unseen, self._latched = self._latched[1], None
        if status is None:
            return
        if status["fault_reports"]:
            self._latched = ring, {name: status[name] for name in ("fault_reports", "trips")}
            self.unseen = None
        else:  # it was reset, by somebody who saw it
            self._latched = None

    def seen(self) -> None:
        """Somebody has seen what the controller before had."""
        self.unseen = None
        self._notify(None)

    async def _in_thread(self, work: Callable[[], Any]) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._threads, work)

    async def _tail(self) -> None:
        """Read the ring; ask for the status where state or fault have changed, or no row comes any more."""
        heard_s = 0.0
        while True:
            if self.source is not None:
                for _ in range(_MOST_READS):
                    before, rows = self.source.latest, self.source.read()
                    if rows is None:
                        break
                    heard_s = time.monotonic()
                    self._notify(rows)
                    if before is None or any(before[name] != rows[-1][name] for name in ("state", "fault")):
                        self._wake.set()
                    await asyncio.sleep(0)
                if self.status is not None and time.monotonic() - heard_s > _SILENT_S:
                    heard_s = time.monotonic()
                    self._wake.set()
            await asyncio.sleep(_TAIL_S)

    async def _look(self) -> None:
        while True:
            try:
                self.take(await self._in_thread(self._ask))
                self.problem, self.heard_s = None, time.monotonic()
                rest_s = _LOOK_S
            except (MicromanipError, OSError, ValueError) as problem:
                self.take(None)
                self.problem = str(problem)
                if self._client is not None:
                    self._client.close()
                    self._client = None
                rest_s = _AGAIN_S
            self._notify(None)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), rest_s)
            self._wake.clear()

    def _ask(self) -> Status:
        if self._client is None:
            client = Client(self.socket)
            try:
                about, descriptors = client.telemetry()
                self._attach(about, descriptors)
            except BaseException:
                client.close()
                raise
            self._client = client
        return self._client.status()

    def _attach(self, about: Telemetry, descriptors: Sequence[int]) -> None:
        inode = os.fstat(descriptors[1]).st_ino
        status, ring, control = mapped(about, descriptors)
        before = self.source
        if before is not None and before.inode == inode:
            return
        is_alike = before is not None and before.about["axes"] == about["axes"]
        history = before.history if before is not None and is_alike else None
        found = Source(about, status, ring, control, inode, history)
        if history is None:
            found.history.take()
        self.source = found

    def _notify(self, rows: Rows | None) -> None:
        for listener in list(self.listeners):
            listener(rows)


def mapped(about: Telemetry, descriptors: Sequence[int]) -> tuple[Any, ...]:
    """Records of `STATUS`, `RING` and `CONTROL`, for reading; the descriptors are closed.

    Raises CheckFailed where the controller, which says what it is `about`, lays them out otherwise.
    """
    try:
        ours = {"status_bytes": STATUS.itemsize, "row_bytes": ROW.itemsize, "control_bytes": CONTROL.itemsize}
        if about != about | ours | {"columns": columns()} or len(descriptors) != len(_MEMORIES):
            raise CheckFailed("the controller is of another version than this program; restart the older one")
        maps = (mmap.mmap(descriptor, 0, prot=mmap.PROT_READ) for descriptor in descriptors)
        return tuple(np.frombuffer(found, dtype, 1)[0] for found, dtype in zip(maps, _MEMORIES, strict=True))
    finally:
        for descriptor in descriptors:
            os.close(descriptor)
