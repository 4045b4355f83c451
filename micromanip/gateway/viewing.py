"""``micromanip recording view``: the scope on a recording, for browsers of this computer, read-only."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from micromanip.errors import CheckFailed, UsageError
from micromanip.recordings import Telemetry, open_telemetry

from .app import Gateway
from .fields import fields
from .guard import Origins
from .recording_history import RecordedHistory
from .serving import is_local, listening, parsed_address, run, shown
from .tokens import Token

_FIRST_LOOK_S = 0.5
_ROOMY = "/var/tmp"
"""Not in memory, as /tmp may be: an overview has up to a gigabyte."""
_YOU = Token("you", "observe", "")


class AnonymousTokens:
    """Tokens of a server that asks for none."""

    def find(self, _: str) -> Token:
        """Whoever comes may look."""
        return _YOU


class RecordedSource:
    """A recording where the gateway expects a source: nothing in it moves on."""

    def __init__(self, telemetry: Telemetry, folder: Path) -> None:
        """Its overview goes to `folder`. CheckFailed where it is damaged, empty, or without what the scope shows."""
        names = telemetry.dtype.names or ()
        if lacking := [name for name in ("cycle", "state", "fault", "axis") if name not in names]:
            raise CheckFailed(f"{telemetry.file}: its rows have no {lacking[0]}: another version wrote it")
        self.fields = fields(telemetry.axes, telemetry.dtype)
        self.history = RecordedHistory(telemetry, self.fields, folder)
        self.reader = SimpleNamespace(lost=int(telemetry.end.get("lost", 0)))
        ranges = {
            axis: [float(limits["low_V"]), float(limits["high_V"])]
            for each in [found for found in telemetry.parameters if len(found)][-1:]
            for axis, limits in zip(telemetry.axes, each["axis"][0]["limiter"], strict=False)
        }
        self.about = {"axes": telemetry.axes, "range_V": ranges, "period_ns": telemetry.period_ns}
        self.recording: dict[str, Any] = {
            "file": telemetry.file.name,
            "first": self.history.oldest,
            "last": self.history.newest,
            "rows": self.history.count,
            "marks": self.history.marks,
            "problem": _how_it_ended(telemetry),
        }

    def so_far(self) -> dict[str, Any]:
        """What a frame says beside its traces: how much of the overview is made, and the marks found by then."""
        return {"known": self.history.overview.share, "marks": self.history.marks}


class RecordedCell:
    """A recording where the gateway expects a cell: no status, no orders, nothing new."""

    def __init__(self, source: RecordedSource) -> None:
        self.source: Any = source
        self.status = self.unseen = None
        self.problem: str | None = None
        self.heard_s = 0.0
        self.listeners: set[Any] = set()

    async def follow(self) -> None:
        """There is nothing to follow."""

    async def order(self, verb: str, name: str, **_: Any) -> Any:  # noqa: ARG002
        """Nobody is there to take it."""
        raise UsageError("a recording takes no orders; `micromanip recording export --cut` takes a part of it")


def _how_it_ended(telemetry: Telemetry) -> str:
    if not telemetry.end:
        return "The recorder was killed, or is still writing: this is what was in the file when it was opened."
    return telemetry.damage()


def view(file: Path, listen: str, say: Callable[[str], None]) -> None:
    """Serve `file` until SIGINT or SIGTERM; a thread reads it into its overview meanwhile.

    Raises CheckFailed where it can't be read, UsageError for an address of others, PermissionDenied or
    DeviceUnavailable where nothing can listen there.
    """
    host, port = parsed_address(listen, "--listen")
    if not is_local(host):
        raise UsageError(f"--listen {listen}: no token is asked for, so it is for this computer only: 127.0.0.1:PORT")
    telemetry = open_telemetry(file)
    with listening(host, port, "--listen") as socket, tempfile.TemporaryDirectory(dir=_ROOMY) as folder:
        source = RecordedSource(telemetry, Path(folder))
        gateway = Gateway(RecordedCell(source), AnonymousTokens(), Origins(), lambda: None, home="scope")  # type: ignore[arg-type]  # as much of both as it asks for
        seconds = (source.recording["last"] - source.recording["first"] + 1) * telemetry.period_ns * 1e-9
        say(f"{file}: {source.recording['rows']} cycles, {seconds:g} s")
        say(f"scope at http://{shown(*socket.getsockname()[:2])}/ for everybody on this computer; Ctrl-C ends it")
        end = time.monotonic() + _FIRST_LOOK_S  # so that the first picture has something to show of the whole
        overview, ended = source.history.overview, threading.Event()
        overview.fill(lambda: time.monotonic() < end)
        filling = threading.Thread(target=overview.fill, args=(lambda: not ended.is_set(),))
        filling.start()
        try:
            run(gateway, socket)
        finally:
            ended.set()
            filling.join()
