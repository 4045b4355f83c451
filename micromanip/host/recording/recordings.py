"""Which recording is under way: begun by `run --record` or by a verb, one at a time.

A client names a file, never a place: the controller may run with rights that the client does not have, so it
writes into its folder of recordings only, and replaces nothing there.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from micromanip.errors import CheckFailed, DeviceUnavailable, UsageError, system_error
from micromanip.host.state_directory import state_directory
from micromanip.replies import Marked
from micromanip.rt import mailbox as w
from micromanip.status_reply import Recorded

from .mcap_file import numbered
from .recording import MCAP, Extent, RecorderProcess, require_new_file

if TYPE_CHECKING:
    from micromanip.host.controller import Controller

_NAME_CHARACTERS = 100
_LOOK_S = 5.0
"""A folder that takes longer to be looked at is refused."""
_NOTHING = "nothing is being recorded; `micromanip recording start` begins"


def default_folder() -> Path:
    """Below what systemd gives by StateDirectory=, or the user's own."""
    return state_directory() / "recordings"


class Recordings:
    """The recordings of one run of the controller."""

    def __init__(self, controller: Controller, folder: Path | None, say: Callable[[str], None]) -> None:
        """`folder` is where those go that a client asks for; `say` gets messages for people."""
        self._controller, self._say = controller, say
        self._folder = default_folder() if folder is None else folder
        self._current: RecorderProcess | None = None
        self._ended = False

    def report(self) -> Recorded | None:
        """How far the present, or else the last recording is; None where there was none."""
        return None if self._current is None else self._current.report()

    async def begin(self, file: Path, extent: Extent | None = None) -> Recorded:
        """Record to `file`, which the caller has looked at. Raises CheckFailed where that can't be begun."""
        current = RecorderProcess(self._controller, file, self._say, extent or Extent())
        before, self._current = self._current, current
        try:
            await current.start()
        except BaseException:
            self._current = before
            raise
        return current.report()

    async def start(self, name: str | None, extent: Extent) -> Recorded:
        """Record to a new file of that name in the folder, one named for the time without.

        Raises UsageError for a name that is a place, or taken, PermissionDenied, DeviceUnavailable, and CheckFailed
        while something is recorded already, or the controller ends.
        """
        self._require_idle()
        file = self._folder / (_checked(name) if name else f"{datetime.now():%Y-%m-%d_%H-%M-%S}{MCAP}")
        first = file if extent.segment_s is None else numbered(file, 1)
        await looked_at(lambda: self._make_room_for(first), self._folder, _LOOK_S)
        self._require_idle()  # another may have begun meanwhile
        return await self.begin(file, extent)

    async def stop(self) -> Recorded:
        """End the recording. Raises CheckFailed where there is none, or it did not end well."""
        current = self._running()
        await current.stop()
        report = current.report()
        if report["message"] is not None:
            raise CheckFailed(report["message"])
        return report

    def mark(self, text: str, by: str) -> Marked:
        """Put a remark into the recording. Raises CheckFailed where there is none, UsageError where it takes none."""
        current = self._running()
        cycle = int(self._controller.words[w.CYCLE])
        current.mark(text, cycle, by)
        return Marked(file=current.report()["file"], cycle=cycle, text=text)

    async def end(self) -> str | None:
        """Once, after the last cycle; what came of the recording that was under way, in a line."""
        if self._ended:
            return None
        self._ended = True
        current = self._current
        return None if current is None or not current.runs else await current.stop()

    def _make_room_for(self, file: Path) -> None:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise system_error(problem, self._folder) from problem
        require_new_file(file, "record start:")

    def _require_idle(self) -> None:
        if self._ended:
            raise CheckFailed("record start refused: the controller is ending")
        if self._current is not None and self._current.runs:
            raise CheckFailed(f"{self._current.report()['file']} is being recorded; stop that first: record stop")

    def _running(self) -> RecorderProcess:
        if self._current is None or not self._current.runs:
            raise CheckFailed(_NOTHING)
        return self._current


def _checked(name: str) -> str:
    """A plain file name, with its ending; UsageError for anything else."""
    if not Path(name).suffix:
        name += MCAP
    plain = name == Path(name).name and not name.startswith(".") and name.isprintable()
    if not plain or len(name) > _NAME_CHARACTERS:
        raise UsageError(
            f"{name!r:.120} is no name of a recording: give a file name of at most {_NAME_CHARACTERS} characters "
            "without a folder; the controller keeps its recordings in a folder of its own, `run --recordings`"
        )
    return name


async def looked_at(look: Callable[[], None], folder: Path, within_s: float) -> None:
    """Let `look` look at `folder`. Raises what it raises, DeviceUnavailable where it takes longer than `within_s`.

    The thread is a daemon, and none of the event loop's: those are waited for at the end, and are few.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[None] = loop.create_future()

    def told(problem: Exception | None) -> None:
        if not done.done():
            done.set_result(None) if problem is None else done.set_exception(problem)

    def run() -> None:
        found: Exception | None = None
        try:
            look()
        except Exception as problem:  # it is raised where it is waited for
            found = problem
        if not loop.is_closed():
            loop.call_soon_threadsafe(told, found)

    threading.Thread(target=run, name="looks at the folder of recordings", daemon=True).start()
    try:
        await asyncio.wait_for(done, within_s)
    except TimeoutError:
        raise DeviceUnavailable(f"{folder} did not answer within {within_s:g} s: does its disk hang?") from None
