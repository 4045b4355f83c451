"""The folder of recordings, looked at by a thread that nobody waits for: a disk that hangs holds up nothing."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable
from pathlib import Path

from micromanip.errors import DeviceUnavailable

_LITTLE_BYTES = 100_000_000
"""Less is told at the start: three axes at 10 kHz fill it in a minute."""


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


def lack(folder: Path) -> str | None:
    """Why nothing, or hardly anything, can be recorded to `folder`; None where all is well. Makes nothing there.

    A folder that is not there yet is made by the first recording: then what it would be made in is judged.
    """
    there = folder.absolute()
    while not os.path.lexists(there):
        there = there.parent
    if not there.is_dir():
        return f"{there} is no folder"
    if not os.access(there, os.W_OK | os.X_OK):  # also root's on a file system that is read-only
        room = os.statvfs(there)
        return f"{there} is on a read-only file system" if room.f_flag & os.ST_RDONLY else f"{there} is not writable"
    room = os.statvfs(there)
    free = room.f_bavail * room.f_frsize
    return f"{there} has {free / 1e6:.0f} MB left" if room.f_blocks and free < _LITTLE_BYTES else None
