"""Recording the telemetry to a file: the host's side, and the layout of the file.

One HDF5 file a recording:

- ``/rows``: every cycle, one compound row each (``micromanip.rt.records.ROW``)
- ``/state``: the loop's whole state at the end of the cycle before the first row
- ``/parameters``: each set of parameters that was in force, in order; a row's ``version`` names one
- attributes: ``configuration`` (its text), ``sha256``, ``axes``, ``period_ns``, ``lost`` (rows the recorder missed so
  far), ``complete`` (the recording was ended, not broken off) and ``problem`` (why it was broken off, where the
  recorder could still say so)
"""

from __future__ import annotations

import asyncio
import importlib.util
import tempfile
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micromanip.errors import CheckFailed, DeviceUnavailable, UsageError, system_error
from micromanip.host.child import Child
from micromanip.replies import Recorded

from .unclosed import close_unclosed

if TYPE_CHECKING:  # the recorder's process needs the layout only
    from micromanip.host.controller import Controller

ROWS, STATE, PARAMETERS = "rows", "state", "parameters"
LOST, COMPLETE, PROBLEM = "lost", "complete", "problem"
_PATIENCE_S, _END_S = 30.0, 1.0
"""A disk may take so long to open or to end a file; a killed process so long to go."""


def require_new_file(file: Path) -> None:
    """Raise where no recording can be begun at `file`: UsageError, PermissionDenied, DeviceUnavailable.

    A recording never replaces anything; the folder is tried with a file that is removed again.
    """
    try:
        is_there, is_file, has_folder = file.is_symlink() or file.exists(), file.is_file(), file.parent.is_dir()
        if has_folder and not is_there:
            with tempfile.TemporaryFile(dir=file.parent) as probe:
                probe.write(b"\0")
    except OSError as problem:
        raise system_error(problem, f"--record {file}") from problem
    if is_there:
        kind = "is there already" if is_file else "is there, and is not a file that can be recorded to"
        raise UsageError(f"--record {file} {kind}: a recording replaces nothing; name another file")
    if not has_folder:
        raise UsageError(f"--record {file}: there is no folder {file.parent}; make it first: mkdir -p {file.parent}")
    if importlib.util.find_spec("h5py") is None:
        raise DeviceUnavailable("--record needs h5py: pip install micromanip[recording]")


class RecorderProcess:
    """The recorder: a process of its own, so that a slow disk holds up nothing, and a full one ends nothing."""

    def __init__(self, controller: Controller, file: Path, say: Callable[[str], None]) -> None:
        """`say` gets a warning where something is missing in the file, at once."""
        self._controller, self._file, self._say = controller, file, say
        self._child = Child("micromanip.host.recording.recorder", controller.segments.descriptors)
        self._answers: AsyncIterator[dict[str, Any]]
        self._following: asyncio.Task[None] | None = None
        self._stopping = False
        self._report = Recorded(file=str(file), state="starting", rows=0, dropped=0, message=None)

    def report(self) -> Recorded:
        """How far it is."""
        return self._report

    async def start(self) -> None:
        """Start it, wait until its file is open, and let the loop make the snapshot it begins with.

        Raises CheckFailed where it can't be opened.
        """
        segments, prepared = self._controller.segments, self._controller.prepared
        orders = {
            "descriptors": segments.descriptors,
            "file": str(self._file.absolute()),
            "configuration": prepared.source.text,
            "sha256": prepared.source.hash,
            "axes": list(prepared.configuration.axes),
            "period_ns": prepared.configuration.loop.period_ns,
        }
        await self._child.start(orders)
        self._answers = self._child.answers()
        answer = await self._opened()
        if "open" not in answer:
            await self._kill()
            raise CheckFailed(f"nothing is recorded: {answer.get('problem', 'the recorder ended at once')}")
        self._child.tell(await self._controller.snapshot())
        self._report["state"] = "recording"
        self._following = asyncio.create_task(self._follow())

    async def stop(self) -> str | None:
        """End the recording; what came of it, in a line; None where it had not begun. Never raises."""
        if self._following is None:
            return None
        self._stopping = True
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
        return f"recorded {self._report['rows']} cycles to {self._file}, {self._report['dropped']} lost"

    async def _opened(self) -> Mapping[str, Any]:
        """Its first word, nothing if it has none; the loop gets its sign of life meanwhile."""

        async def first_word() -> Mapping[str, Any]:
            return await anext(self._answers, {})

        hearing = asyncio.create_task(first_word())
        for _ in range(round(_PATIENCE_S / 0.02)):
            self._controller.beat()
            done, _ = await asyncio.wait({hearing}, timeout=0.02)
            if done:
                return hearing.result()
        hearing.cancel()
        return {"problem": f"{self._file} could not be opened within {_PATIENCE_S:g} s: does its disk hang?"}

    async def _follow(self) -> None:
        """Take note of what it says until it ends; tell at once where it was not told to."""
        last: Mapping[str, Any] = {}
        async for said in self._answers:
            last = said
            self._note(said)
        await self._child.wait()
        if "complete" in last:
            self._report["state"] = "complete"
            return
        if "problem" in last:
            why = f"{self._file}: {last['problem']}"
            next_step = "make room there, or record to another disk"
        else:
            why = f"the recorder of {self._file} died"
            next_step = "look for what killed it in the system's log"
        unclosed = "problem" not in last or "unclosed" in last
        mended = not unclosed or await asyncio.to_thread(self._mend)
        readable = "" if mended else f"; `h5clear -s {self._file}` opens it"
        kept = f"some {self._report['rows']} cycles are in it{readable}"
        self._report["state"] = "failed"
        self._report["message"] = f"{why}, nothing more is recorded; {kept}; {next_step}"
        if not self._stopping:
            self._say(f"WARNING: {self._report['message']}")

    def _note(self, said: Mapping[str, Any]) -> None:
        rows, lost = said.get("rows"), said.get("lost")
        if isinstance(rows, int):
            self._report["rows"] = max(rows, self._report["rows"])
        if isinstance(lost, int):
            if lost and not self._report["dropped"]:
                self._say(f"WARNING: {lost} cycles are missing in {self._file}: its disk, or this machine, is too slow")
            self._report["dropped"] = lost

    def _mend(self) -> bool:
        try:
            return close_unclosed(self._file.absolute())
        except OSError:
            return False

    async def _kill(self) -> None:
        self._child.kill()
        await self._child.wait(_END_S)  # a disk that hangs keeps even the killed
