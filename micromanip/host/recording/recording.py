"""Recording the telemetry to a file: the host's side of one recorder process."""

from __future__ import annotations

import asyncio
import contextlib
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, model_validator

from micromanip.errors import CheckFailed, UsageError, system_error
from micromanip.host.child import Child
from micromanip.rt import mailbox as w
from micromanip.settings.schema.base import Settings
from micromanip.status_reply import Recorded

if TYPE_CHECKING:  # the recorder's process needs the layout only
    from micromanip.host.controller import Controller

MCAP = ".mcap"


class Extent(Settings):
    """What a recording takes: `before_s` of what the ring still holds, and all from then on.

    With `segment_s` it goes into numbered files of that length; beyond `quota_bytes` the oldest are removed.
    """

    before_s: Annotated[float, Field(strict=True, ge=0, le=5, allow_inf_nan=False)] = Field(
        default=0.0, description="Begin so much earlier, s."
    )
    segment_s: Annotated[float, Field(strict=True, ge=1, le=86_400, allow_inf_nan=False)] | None = Field(
        default=None, description="Begin another file so often, s."
    )
    quota_bytes: Annotated[int, Field(strict=True, ge=1_000_000, le=10**16)] | None = Field(
        default=None, description="Remove the oldest of these files beyond that."
    )

    @model_validator(mode="after")
    def _both_or_neither(self) -> Self:
        if (self.segment_s is None) != (self.quota_bytes is None):
            raise ValueError("segment_s and quota_bytes go together: how long a file is, and how much all may take")
        return self


_FROM_NOW = Extent()
_STATE_S = 10.0
"""How often the loop's state goes into a file."""
_PATIENCE_S, _END_S = 30.0, 1.0
"""A disk may take so long to begin or to end a file; a killed process so long to go. A client waits for longer."""


def require_new_file(file: Path, told: str = "--record") -> None:
    """Raise where no recording can be begun at `file`: UsageError, PermissionDenied.

    A recording never replaces anything; the folder is tried with a file that is removed again. `told` begins a message.
    """
    try:
        is_there, is_file, has_folder = file.is_symlink() or file.exists(), file.is_file(), file.parent.is_dir()
        if has_folder and not is_there:
            with tempfile.TemporaryFile(dir=file.parent) as probe:
                probe.write(b"\0")
    except OSError as problem:
        raise system_error(problem, f"{told} {file}") from problem
    if is_there:
        kind = "is there already" if is_file else "is there, and is not a file that can be recorded to"
        raise UsageError(f"{told} {file} {kind}: a recording replaces nothing; name another file")
    if not has_folder:
        raise UsageError(f"{told} {file}: there is no folder {file.parent}; make it first: mkdir -p {file.parent}")
    if file.suffix != MCAP:
        raise UsageError(f"{told} {file}: a recording is an MCAP file: give a name that ends in {MCAP}")


class RecorderProcess:
    """The recorder: a process of its own, so that a slow disk holds up nothing, and a full one ends nothing."""

    def __init__(
        self, controller: Controller, file: Path, say: Callable[[str], None], extent: Extent = _FROM_NOW
    ) -> None:
        """`say` gets a warning where something is missing in the file, at once."""
        self._controller, self._file, self._say, self._extent = controller, file, say, extent
        self._child = Child("micromanip.host.recording.recorder", controller.segments.descriptors)
        self._answers: AsyncIterator[dict[str, Any]]
        self._following: asyncio.Task[None] | None = None
        self._keeping: asyncio.Task[None] | None = None
        self._stopping = False
        self._report = Recorded(file=str(file), state="starting", rows=0, dropped=0, message=None, bytes=0, marks=0)

    def report(self) -> Recorded:
        """How far it is."""
        return self._report

    async def start(self) -> None:
        """Start it, wait until its file is open, and has the snapshot that the loop makes for it to begin with.

        Raises CheckFailed where that can't be; then there is no process, and no file of it.
        """
        segments, prepared = self._controller.segments, self._controller.prepared
        orders = {
            "descriptors": segments.descriptors,
            "file": str(self._file.absolute()),
            "configuration": prepared.source.text,
            "sha256": prepared.source.hash,
            "axes": list(prepared.configuration.axes),
            "period_ns": prepared.configuration.loop.period_ns,
            "head": int(self._controller.ring["words"][w.RING_HEAD]),  # before what starting takes
            "before_s": self._extent.before_s,
            "segment_s": self._extent.segment_s,
            "quota_bytes": self._extent.quota_bytes,
        }
        await self._child.start(orders)
        self._answers = self._child.answers()
        until_s = time.monotonic() + _PATIENCE_S
        try:
            await self._hear("open", until_s)
            self._child.send(await self._snapshot())
            await self._hear("begun", until_s)
        except BaseException:
            self._child.end_orders()  # one that has opened its file takes it away
            if not await self._child.wait(_END_S):
                await self._kill()
            raise
        self._report["state"] = "recording"
        self._following = asyncio.create_task(self._follow())
        self._keeping = asyncio.create_task(self._keep_states())

    @property
    def runs(self) -> bool:
        """Whether it still records."""
        return self._report["state"] in ("starting", "recording")

    def mark(self, text: str, cycle: int, by: str) -> None:
        """Put a remark on the present `cycle` into the file."""
        self._child.send({"text": text, "cycle": cycle, "by": by, "time_ns": time.monotonic_ns()})
        self._report["marks"] += 1

    async def stop(self) -> str | None:
        """End the recording; what came of it, in a line; None where it had not begun. Never raises."""
        if self._following is None:
            return None
        self._stopping = True
        if self._keeping is not None:
            self._keeping.cancel()
        self._child.end_orders()
        done, _ = await asyncio.wait({self._following}, timeout=_PATIENCE_S)
        if not done:
            await self._kill()
            await asyncio.wait({self._following}, timeout=_END_S)
        if self._report["state"] == "recording":
            self._report["state"] = "failed"
            self._report["message"] = f"the recorder of {self._file} did not end: does its disk hang?"
        if self._report["message"] is not None:
            return f"WARNING: {self._report['message']}"
        return self._outcome()

    def _outcome(self) -> str:
        return f"recorded {self._report['rows']} cycles to {self._file}, {self._report['dropped']} lost"

    async def _snapshot(self) -> int:
        try:
            return await self._controller.snapshot()
        except CheckFailed as problem:
            state = self._controller.state
            raise CheckFailed(f"nothing is recorded, as the state is {state}: {problem}; try again later") from None

    async def _hear(self, word: str, until_s: float) -> None:
        """Wait for its next word; the loop gets its sign of life meanwhile. Raises CheckFailed where it is another."""

        async def next_word() -> Mapping[str, Any]:
            return await anext(self._answers, {})

        hearing = asyncio.create_task(next_word())
        while time.monotonic() < until_s:
            self._controller.beat()
            done, _ = await asyncio.wait({hearing}, timeout=0.02)
            if done:
                said = hearing.result()
                if word not in said:
                    raise CheckFailed(f"nothing is recorded: {said.get('problem', 'the recorder ended at once')}")
                return
        hearing.cancel()
        why = f"{self._file} was not begun within {_PATIENCE_S:g} s: does its disk hang, or is this machine overloaded?"
        raise CheckFailed(f"nothing is recorded: {why}")

    async def _keep_states(self) -> None:
        """Let the loop copy its state again and again: a replay may begin at each."""
        while self.runs:
            await asyncio.sleep(_STATE_S)
            with contextlib.suppress(CheckFailed):  # a loop that has ended, or stands still, makes none
                cycle = await self._controller.snapshot()
                if self.runs:
                    self._child.send({"state": cycle})

    async def _follow(self) -> None:
        """Take note of what it says until it ends; tell at once where it was not told to."""
        last: Mapping[str, Any] = {}
        async for said in self._answers:
            last = said
            self._note(said)
        await self._child.wait()
        if "complete" in last:
            self._report["state"] = "complete"
            if not self._stopping:
                self._say(self._outcome())
            return
        if "problem" in last:
            why = f"{self._file}: {last['problem']}"
            next_step = "make room there, or record to another disk"
        else:
            why = f"the recorder of {self._file} died"
            next_step = "look for what killed it in the system's log"
        kept = f"some {self._report['rows']} cycles are in it"
        self._report["state"] = "failed"
        self._report["message"] = f"{why}, nothing more is recorded; {kept}; {next_step}"
        if not self._stopping:
            self._say(f"WARNING: {self._report['message']}")

    def _note(self, said: Mapping[str, Any]) -> None:
        rows, lost, size = said.get("rows"), said.get("lost"), said.get("bytes")
        self._report["file"] = said.get("file", self._report["file"])
        if isinstance(size, int):
            self._report["bytes"] = size
        if isinstance(rows, int):
            self._report["rows"] = max(rows, self._report["rows"])
        if isinstance(lost, int):
            if lost and not self._report["dropped"]:
                self._say(f"WARNING: {lost} cycles are missing in {self._file}: its disk, or this machine, is too slow")
            self._report["dropped"] = lost

    async def _kill(self) -> None:
        self._child.kill()
        await self._child.wait(_END_S)  # a disk that hangs keeps even the killed
