"""Talk to a running controller: the same verbs as the commands.

from micromanip.client import Client

with Client() as cell:
    cell.arm()
    print(cell.status()["path_error_um"])
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

from . import replies, status_reply
from .errors import CheckFailed, ConfigError, DeviceUnavailable, MicromanipError, PermissionDenied, UsageError

_TIMEOUT_S = 10.0
_LONGER_S = {"recording_start": 45.0, "recording_stop": 45.0}
"""Verbs whose answer may take longer: the controller itself gives up on a disk before that."""
_TRIAL_LOOK_S, _INJECTED_LOOK_S = 0.1, 0.2
_MEMORIES = 3


def default_socket() -> Path:
    """``/run/micromanip/control.sock`` for the system's service, else one of the user's own."""
    system = Path("/run/micromanip/control.sock")
    if os.geteuid() == 0 or system.exists():
        return system
    return Path(os.environ.get("XDG_RUNTIME_DIR", f"/tmp/micromanip-{os.geteuid()}")) / "micromanip.sock"


class Client:
    """A connection to the control socket of a running controller."""

    def __init__(self, path: Path | None = None, on_behalf_of: str | None = None) -> None:
        """Raises DeviceUnavailable where no controller runs, PermissionDenied where it may not be reached.

        `on_behalf_of` is noted in the audit trail beside the user that asks; it gives no rights.
        """
        self.path = path or default_socket()
        self._named = {} if on_behalf_of is None else {"on_behalf_of": on_behalf_of}
        self._connect()

    def _connect(self) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(_TIMEOUT_S)
        try:
            self._socket.connect(str(self.path))
        except PermissionError as problem:
            self._socket.close()
            raise PermissionDenied(
                f"{self.path}: not allowed; your user must be in the controller's group"
            ) from problem
        except OSError as problem:
            self._socket.close()
            there = "" if self.path == default_socket() else f" --socket {self.path}"
            raise DeviceUnavailable(
                f"no controller answers on {self.path}; start one with `micromanip run CONFIG{there}`"
            ) from problem
        self._require_trusted()
        self._lines = self._socket.makefile("rb")

    def _require_trusted(self) -> None:
        """PermissionDenied where the server is neither root's nor the caller's, nor that of the folder's owner.

        Where others may write in a folder above it, whoever was first owns the folder: that proves nothing.
        """
        server = struct.unpack("3i", self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[1]
        if server in (0, os.geteuid()):
            return
        folder, *above = self.path.resolve().parents
        closed = all(not each.stat().st_mode & 0o022 and each.stat().st_uid in (0, server) for each in above)
        if not closed or folder.stat().st_uid != server or folder.stat().st_mode & 0o002:
            self._socket.close()
            raise PermissionDenied(
                f"{self.path}: what answers there belongs to user {server}, who may be a stranger; nothing was asked"
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the connection."""
        self._lines.close()
        self._socket.close()

    def request(self, verb: str, **fields: Any) -> Any:
        """Result of `verb`; raises what the controller answered where it refused, DeviceUnavailable with no answer."""
        try:
            asked = json.dumps({"version": 1, "verb": verb, **self._named, **fields}, allow_nan=False).encode() + b"\n"
        except ValueError:
            raise UsageError(
                f"{verb}: expected finite numbers, not NaN or infinity; where no limit is meant, null says so"
            ) from None
        line = b""
        if self._was_idle():
            self.close()
            self._connect()
        with self._answered(verb), contextlib.suppress(ConnectionError):
            self._socket.sendall(asked)
            line = self._lines.readline()
        return self._result(line)

    @contextlib.contextmanager
    def _answered(self, verb: str) -> Iterator[None]:
        """DeviceUnavailable where `verb` is not answered in time; the connection is let go: it may still be."""
        within_s = _LONGER_S.get(verb, _TIMEOUT_S)
        self._socket.settimeout(within_s)
        try:
            yield
        except TimeoutError:
            self.close()
            raise DeviceUnavailable(
                f"the controller on {self.path} did not answer {verb} within {within_s:g} s: whether it has done it, "
                "or will, is not known; `micromanip status` and `micromanip log` tell"
            ) from None

    def _result(self, line: bytes) -> Any:
        if not line:
            raise DeviceUnavailable(f"the controller on {self.path} went away")
        answer = json.loads(line)
        if answer["ok"]:
            return answer["result"]
        kinds: dict[int, type[MicromanipError]] = {
            k.exit_code: k for k in (UsageError, PermissionDenied, DeviceUnavailable, ConfigError)
        }
        raise kinds.get(answer["exit_code"], CheckFailed)(answer["error"])

    def _was_idle(self) -> bool:
        """Whether the controller has said good-bye meanwhile, because nothing was asked for long."""
        if self._socket.fileno() < 0:  # let go, for want of an answer
            return True
        poll = select.poll()
        poll.register(self._socket, select.POLLIN)
        with contextlib.suppress(ConnectionError):
            return bool(poll.poll(0)) and self._socket.recv(1, socket.MSG_PEEK) != b""
        return False

    def telemetry(self) -> tuple[replies.Telemetry, list[int]]:
        """What the telemetry's memory holds, and read-only descriptors: of the loop's status, of
        its ring, and of the parameters.

        They are the caller's to close, and stay good for reading when the controller has ended.
        """
        self.close()  # descriptors come with the first bytes of the answer: nothing may be read ahead
        self._connect()
        line = b""
        descriptors: list[int] = []
        try:
            with self._answered("telemetry"), contextlib.suppress(ConnectionError):
                self._socket.sendall(json.dumps({"version": 1, "verb": "telemetry", **self._named}).encode() + b"\n")
                line, descriptors, _, _ = socket.recv_fds(self._socket, 1 << 16, _MEMORIES)
                while line and not line.endswith(b"\n"):
                    line += self._socket.recv(1 << 16)
            told: replies.Telemetry = self._result(line)
        except BaseException:
            for descriptor in descriptors:
                os.close(descriptor)
            raise
        return told, descriptors

    def configuration(self) -> replies.RunningConfiguration:
        """What runs, as a text of YAML, with its hash."""
        return cast(replies.RunningConfiguration, self.request("configuration"))

    def status(self) -> status_reply.Status:
        """The report of the run so far, as ``run --json`` ends with."""
        return cast(status_reply.Status, self.request("status"))

    def arm(self) -> None:
        """Soft start into TRACKING; returns once arming has begun."""
        self.request("arm")

    def disarm(self) -> None:
        """Soft stop to the park voltage; returns once it has begun."""
        self.request("disarm")

    def hold(self) -> None:
        """Freeze the correction: every axis stays where it is, its loops closed; `arm` goes on."""
        self.request("hold")

    def reset(self) -> None:
        """Clear a latched fault; nothing moves."""
        self.request("reset")

    def learn_part_begin(self) -> None:
        """A part begins now."""
        self.request("learn_part_begin")

    def learn_part_end(self) -> None:
        """The part that is being made has ended."""
        self.request("learn_part_end")

    def learn_status(self) -> status_reply.LearningStatus:
        """What is learned from part to part, and played."""
        return cast(status_reply.LearningStatus, self.request("learn_status"))

    def learn_reset(self, *axes: str) -> None:
        """Forget what is learned of `axes`, all without any; what is played fades out."""
        self.request("learn_reset", axes=axes)

    def get(self, *keys: str) -> list[replies.Parameter]:
        """Running values of keys, of all below where one is a section; all values without keys."""
        return cast(list[replies.Parameter], self.request("get", keys=keys))

    def value(self, key: str) -> Any:
        """The running value of one key."""
        found = {parameter["key"]: parameter["value"] for parameter in self.get(key)}
        if key not in found:
            raise UsageError(f"{key} is a section; its keys are {', '.join(found)}")
        return found[key]

    def set(self, changes: Mapping[str, Any]) -> replies.Swap:
        """Change values (key -> value), all at one cycle boundary or none; raises with each reason why not."""
        return cast(replies.Swap, self.request("set", changes=dict(changes)))

    def candidate_set(self, changes: Mapping[str, Any]) -> replies.Candidate:
        """Let a candidate, what runs but with `changes` (key -> value), compute beside it; where it stands.

        Raises as `set`; live keys only.
        """
        return cast(replies.Candidate, self.request("candidate_set", changes=dict(changes)))

    def candidate_show(self) -> replies.Candidate:
        """Where the last candidate stands, and how it compares."""
        return cast(replies.Candidate, self.request("candidate_show"))

    def candidate_promote(self) -> replies.Candidate:
        """Put the candidate in force, on trial; raises CheckFailed where there is none or nothing tracks."""
        return cast(replies.Candidate, self.request("candidate_promote"))

    def candidate_outcome(self) -> replies.Candidate:
        """Wait for the end of the trial; the outcome: confirmed, taken back (or dropped: none)."""
        while (candidate := self.candidate_show())["standing"] == "on trial":
            time.sleep(_TRIAL_LOOK_S)
        return candidate

    def candidate_discard(self) -> replies.Candidate:
        """Let the candidate go; where it is on trial, what ran before is in force again."""
        return cast(replies.Candidate, self.request("candidate_discard"))

    def diff(self) -> replies.Differences:
        """The configuration file as it is on disk against what runs."""
        return cast(replies.Differences, self.request("diff"))

    def save(self, *, force: bool = False) -> replies.Saved:
        """Write the running values into the file; refused where somebody edited it meanwhile, unless `force`."""
        return cast(replies.Saved, self.request("save", force=force))

    def jog(self, axis: str, *, by_um: float | None = None, to_um: float | None = None) -> replies.Jogged:
        """Send an axis `by_um` from its present target, or `to_um`; returns when it is on its way."""
        return cast(replies.Jogged, self.request("jog", axis=axis, by_um=by_um, to_um=to_um))

    def analyse_live(
        self,
        axis: str,
        loop: str,
        amplitude_um: float,
        seed: int = 1,
        *,
        progress: Callable[[float], None] | None = None,
    ) -> tuple[replies.Injected, replies.Response]:
        """Let the running loop inject a small multisine, and wait for the response of its plant.

        It is taken back where this client goes away. Raises CheckFailed where it is refused, or was ended early.
        """
        begun: replies.Injected = self.request(
            "analyse_live", axis=axis, loop=loop, amplitude_um=amplitude_um, seed=seed
        )
        while not (response := self.request("analyse_live", number=begun["number"]))["done"]:
            if progress is not None:
                progress(response["progress"])
            time.sleep(_INJECTED_LOOK_S)
        found: replies.Response = response
        return begun, found

    def move(
        self, axis: str, kind: str, *, progress: Callable[[replies.Moved], None] | None = None, **wanted: Any
    ) -> replies.Moved:
        """Move an axis that is held, and wait for the end; `wanted`: fields of `settings.move_plan.MoveRequest`.

        It comes to rest where this client goes away. Raises CheckFailed where it is refused, or was ended early.
        """
        moved: replies.Moved = self.request("move", axis=axis, kind=kind, **wanted)
        while not moved["done"]:
            if progress is not None:
                progress(moved)
            time.sleep(_INJECTED_LOOK_S)
            moved = self.request("move", number=moved["number"])
        return moved

    def reload(self) -> replies.Swap:
        """Take over the configuration file as it is now, all of it or nothing."""
        return cast(replies.Swap, self.request("reload"))

    def log(self, last: int = 20) -> replies.Audit:
        """The newest entries of the audit trail, oldest first."""
        return cast(replies.Audit, self.request("log", last=last))

    def recording_start(
        self,
        file: str | None = None,
        *,
        before_s: float = 0.0,
        segment_s: float | None = None,
        quota_bytes: int | None = None,
    ) -> status_reply.Recorded:
        """Record to a new file of that name in the controller's folder, one named for the time without.

        `before_s` (s) of what has been is in it, too. With `segment_s` it goes on in numbered files of that length, of
        which the oldest are removed beyond `quota_bytes`.
        """
        extent = {"before_s": before_s, "segment_s": segment_s, "quota_bytes": quota_bytes}
        return cast(status_reply.Recorded, self.request("recording_start", file=file, **extent))

    def recording_stop(self) -> status_reply.Recorded:
        """End the recording; raises CheckFailed where there is none, or it failed."""
        return cast(status_reply.Recorded, self.request("recording_stop"))

    def recording_mark(self, text: str) -> replies.Marked:
        """Put a remark into the recording."""
        return cast(replies.Marked, self.request("recording_mark", text=text))
