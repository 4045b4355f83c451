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
import socket
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from micromanip.errors import CheckFailed, DeviceUnavailable, MicromanipError, PermissionDenied, UsageError

_TIMEOUT_S = 10.0


def default_socket() -> Path:
    """``/run/micromanip/control.sock`` for the system's service, else one of the user's own."""
    system = Path("/run/micromanip/control.sock")
    if os.geteuid() == 0 or system.exists():
        return system
    return Path(os.environ.get("XDG_RUNTIME_DIR", f"/tmp/micromanip-{os.geteuid()}")) / "micromanip.sock"


class Client:
    """A connection to the control socket of a running controller."""

    def __init__(self, path: Path | None = None) -> None:
        """Raises DeviceUnavailable where no controller runs, PermissionDenied where it may not be reached."""
        self.path = path or default_socket()
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
            raise DeviceUnavailable(
                f"no controller answers on {self.path}; start one with `micromanip run CONFIG`"
            ) from problem
        self._lines = self._socket.makefile("rb")

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
        """Result of `verb`; raises what the controller answered where it refused."""
        line = b""
        with contextlib.suppress(ConnectionError):
            self._socket.sendall(json.dumps({"version": 1, "verb": verb, **fields}).encode() + b"\n")
            line = self._lines.readline()
        if not line:
            raise DeviceUnavailable(f"the controller on {self.path} went away")
        answer = json.loads(line)
        if answer["ok"]:
            return answer["result"]
        kinds: dict[int, type[MicromanipError]] = {
            k.exit_code: k for k in (UsageError, PermissionDenied, DeviceUnavailable)
        }
        raise kinds.get(answer["exit_code"], CheckFailed)(answer["error"])

    def status(self) -> dict[str, Any]:
        """The report of the run so far, as ``run --json`` ends with."""
        result: dict[str, Any] = self.request("status")
        return result

    def arm(self) -> None:
        """Soft start into TRACKING; returns once arming has begun."""
        self.request("arm")

    def disarm(self) -> None:
        """Soft stop to the park voltage; returns once it has begun."""
        self.request("disarm")

    def reset(self) -> None:
        """Clear a latched fault; nothing moves."""
        self.request("reset")
