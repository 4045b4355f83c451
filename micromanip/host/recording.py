"""Recording the telemetry to a file: the host's side, and the layout of the file.

One HDF5 file a recording:

- ``/rows``: every cycle, one compound row each (``micromanip.rt.records.ROW``)
- ``/state``: the loop's whole state at the end of the cycle before the first row
- ``/parameters``: each set of parameters that was in force, in order; a row's ``version`` names one
- attributes: ``configuration`` (its text), ``sha256``, ``axes``, ``period_ns``, ``lost`` (rows the recorder missed)
"""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path

from micromanip.errors import CheckFailed

from .controller import Controller

ROWS, STATE, PARAMETERS = "rows", "state", "parameters"


class RecorderProcess:
    """The recorder: a process of its own, so that a slow disk holds up nothing."""

    def __init__(self, controller: Controller, file: Path) -> None:
        self._controller, self._file = controller, file
        self._process: asyncio.subprocess.Process | None = None

    async def start(self) -> None:
        """Start it, wait until its file is open, and let the loop make the snapshot it begins with."""
        segments, prepared = self._controller.segments, self._controller.prepared
        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            *("-m", "micromanip.host.recorder"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            pass_fds=segments.descriptors,
            start_new_session=True,
        )
        orders = {
            "descriptors": segments.descriptors,
            "file": str(self._file.resolve()),
            "configuration": prepared.source.text,
            "sha256": prepared.source.hash,
            "axes": list(prepared.configuration.axes),
            "period_ns": prepared.configuration.loop.period_ns,
        }
        await self._tell(json.dumps(orders))
        while True:
            self._controller.beat()
            try:
                answer = await asyncio.wait_for(self._hear(), 0.05)
                break
            except TimeoutError:
                continue
        if answer != "open":
            assert self._process.stdin is not None
            self._process.stdin.close()
            await self._process.wait()
            raise CheckFailed(f"nothing is recorded: {answer or 'the recorder ended at once'}")
        await self._tell(str(await self._controller.snapshot()))

    async def _tell(self, line: str) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(line.encode() + b"\n")
        await self._process.stdin.drain()

    async def _hear(self) -> str:
        assert self._process is not None
        assert self._process.stdout is not None
        return (await self._process.stdout.readline()).decode().strip()

    async def death(self) -> str:
        """Wait until the process ends without having been told to; what to say of it."""
        assert self._process is not None
        await self._process.wait()
        return f"the recorder of {self._file} died, nothing more is recorded; {self._remedy}"

    @property
    def _remedy(self) -> str:
        return f"`h5clear -s {self._file}` opens what it had written"

    async def stop(self) -> str:
        """End the recording; what came of it, in a line."""
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.close()
        said = await self._hear()
        await self._process.wait()
        return said or f"the recorder of {self._file} died; {self._remedy}"
