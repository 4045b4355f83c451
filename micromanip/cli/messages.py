"""Messages of a running controller: standard error may stand still (a pager, Ctrl-S) or break, and nobody waits."""

from __future__ import annotations

import contextlib
import io
import os
import queue
import sys
import threading
from collections.abc import Callable
from types import TracebackType
from typing import IO, Self, cast

from rich.console import Console

_MOST = 1000
"""Messages that wait for their turn; later ones are lost."""
_END_S = 2.0


class _Descriptor(io.TextIOBase):
    """A stream without buffer or lock: Python can end while a thread still waits in it."""

    def __init__(self, number: int) -> None:
        self._number = number

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return "utf-8"

    def fileno(self) -> int:
        return self._number

    def isatty(self) -> bool:
        return os.isatty(self._number)

    def write(self, text: str) -> int:
        rest = text.encode(errors="replace")
        while rest:
            rest = rest[os.write(self._number, rest) :]
        return len(text)


class _ErrorConsole(Console):
    def on_broken_pipe(self) -> None:
        """Say nothing more. Rich's own would end the program, and send its standard output nowhere."""
        self.quiet = True


def error_console() -> Console:
    """A console on standard error, for `Printer`'s thread alone."""
    try:
        return _ErrorConsole(file=cast(IO[str], _Descriptor(sys.stderr.fileno())), highlight=False)
    except (AttributeError, OSError):  # there is none, or a stand-in without a descriptor
        return _ErrorConsole(stderr=True, highlight=False)


class Printer:
    """Does what prints in a thread of its own, one after the other; nobody waits for it but `close`, shortly."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[Callable[[], object] | None] = queue.Queue(_MOST)
        self._thread = threading.Thread(target=self._run, name="messages", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(queue.Full):
            self._waiting.put_nowait(None)
            self._thread.join(_END_S)

    def do(self, prints: Callable[[], object]) -> None:
        """Let the thread call `prints`."""
        with contextlib.suppress(queue.Full):
            self._waiting.put_nowait(prints)

    def _run(self) -> None:
        while (prints := self._waiting.get()) is not None:
            with contextlib.suppress(OSError, SystemExit):  # nobody reads any more; rich would end the program
                prints()
