"""Word to the service manager: the protocol of sd_notify(3) over the socket that it names, or silence.

One datagram of ``NAME=value`` lines each. Where nobody listens (a run from a terminal) all of this does nothing;
a message that can't be sent is lost, because nothing here may hold up or end the controller.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import time
from collections.abc import Callable, Iterator, Mapping

_FEEDINGS = 4
"""How often the watchdog is fed in its time: three feedings in a row may be late or lost."""


class ServiceManager:
    """The service manager that started this process, if one did."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        """`environment` holds NOTIFY_SOCKET (a path, or an abstract name after ``@``), WATCHDOG_USEC, WATCHDOG_PID."""
        path = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._status, self._ready = "", False
        self.watchdog_s = _watchdog_s(environment) if self._address else None
        """Time after which the service manager ends a process that has not fed its watchdog; None: it has none."""

    def ready(self) -> None:
        """Starting is done."""
        self._ready = True
        self._send("READY=1")

    @contextlib.contextmanager
    def reload(self) -> Iterator[None]:
        """The configuration is read again meanwhile; before `ready` nobody is told, it would count as that."""
        if not self._ready:
            yield
            return
        self._send("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")
        try:
            yield
        finally:
            self._send("READY=1")

    def stopping(self) -> None:
        """The orderly end has begun."""
        self._send("STOPPING=1")

    def status(self, text: str) -> None:
        """One line for people, as ``systemctl status`` shows it; sent where it changed."""
        if text != self._status:
            self._status = text
            self._send("STATUS=" + " ".join(text.splitlines()))

    async def feed_while(self, progress: Callable[[], tuple[int, ...]]) -> None:
        """Feed the watchdog as long as every counter of `progress` has moved since the last feeding; runs for ever."""
        if self.watchdog_s is None:
            return
        fed: tuple[int, ...] = ()
        while True:
            now = progress()
            if not fed or all(new != old for new, old in zip(now, fed, strict=True)):
                fed = now
                self._send("WATCHDOG=1")
            await asyncio.sleep(self.watchdog_s / _FEEDINGS)

    def _send(self, *lines: str) -> None:
        if self._address:
            send_datagram(self._address, "\n".join(lines).encode(errors="replace"))


def send_datagram(address: str, content: bytes) -> bool:
    """Hand it to whoever listens there; False where nobody takes it at once. Never blocks."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender, contextlib.suppress(OSError, UnicodeError):
        sender.setblocking(False)
        sender.sendto(content, address)
        return True
    return False


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None  # meant for another process, which left its environment to us
    try:
        period_us = int(environment.get("WATCHDOG_USEC", ""))
    except ValueError:
        return None
    return period_us * 1e-6 if period_us > 0 else None
