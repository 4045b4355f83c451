"""The bus that CAN devices are emulated on, as the configuration of their driver has it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from micromanip.errors import UsageError
from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.faults import parsed
from micromanip.testbus.hub import CanHub

from .python_can_bus import PythonCanBus

_TEST_BUS = "micromanip"


class CanBus:
    """The test bus, or an interface of python-can; what is the same whatever is spoken on it."""

    def __init__(self, keys: Any, loop: EventLoop) -> None:
        """The bus that a driver's options name. Raises DeviceUnavailable where it is in use, or can't be reached."""
        s = self._keys = keys
        self.line: CanHub | PythonCanBus
        if s.interface == _TEST_BUS:
            self.line = CanHub(loop, str(s.channel), s.bitrate, s.data_bitrate)
        else:
            self.line = PythonCanBus(loop, s.interface, str(s.channel), s.bitrate, s.data_bitrate)
        self._loop = loop
        self._began_ns = loop.now_ns()

    def ready(self, out: int, into: int) -> str:
        """With so many messages out of the devices, and into them."""
        s = self._keys
        kbits = "/".join(f"{rate / 1e3:g}" for rate in (s.bitrate, s.data_bitrate) if rate)
        return f"{s.channel}: {out} message{'s' * (out != 1)} out, {into} in, {kbits} kbit/s"

    def start(self, now_ns: int) -> None:
        """Count the load from now on."""
        self._began_ns = now_ns

    def inject(self, fault: Mapping[str, Any]) -> None:
        """Disturb the bus. Raises UsageError for what is no such fault, or where it isn't the test bus."""
        if not isinstance(self.line, CanHub):
            name = f"{self._keys.interface} {self._keys.channel}"
            raise UsageError(f"{name} can't be disturbed; the test bus, interface {_TEST_BUS}, can")
        self.line.faults.inject(parsed(dict(fault)))

    def clear(self) -> None:
        """End what was injected."""
        if isinstance(self.line, CanHub):
            self.line.faults.clear()

    def report(self) -> dict[str, Any]:
        """Frames and load since the start."""
        bus = self.line.statistics
        elapsed_ns = max(1, self._loop.now_ns() - self._began_ns)
        return {
            "frames": bus.frames,
            "destroyed": bus.destroyed,
            "bus_load_percent": round(100 * bus.busy_ns / elapsed_ns, 2),
        }

    def close(self) -> None:
        """Let go of the bus."""
        self.line.close()
