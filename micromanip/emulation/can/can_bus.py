"""The bus that CAN devices are played on, as the configuration of their driver has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from micromanip.emulation.plain_options import value
from micromanip.errors import UsageError
from micromanip.settings.text.source import Source
from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.faults import parsed
from micromanip.testbus.hub import CanHub

from .python_can_bus import PythonCanBus

_TEST_BUS = "micromanip"


@dataclass(frozen=True)
class BusSettings:
    """Which bus."""

    interface: str
    channel: str
    bitrate: int
    data_bitrate: int | None


def read_bus_settings(place: tuple[str, ...], options: Mapping[str, Any], source: Source) -> BusSettings:
    """From the options of the driver at `place`; raises ConfigError with file, line and key."""
    return BusSettings(
        interface=value(source, place, options, "interface", str),
        channel=str(value(source, place, options, "channel", (str, int))),
        bitrate=value(source, place, options, "bitrate", int),
        data_bitrate=value(source, place, options, "data_bitrate", int) if options.get("data_bitrate") else None,
    )


class CanBus:
    """The test bus, or an interface of python-can; what is the same whatever is spoken on it."""

    def __init__(self, settings: BusSettings, loop: EventLoop) -> None:
        """Raises DeviceUnavailable for a channel that is in use, or can't be reached."""
        s = self._settings = settings
        self.line: CanHub | PythonCanBus
        if s.interface == _TEST_BUS:
            self.line = CanHub(loop, s.channel, s.bitrate, s.data_bitrate)
        else:
            self.line = PythonCanBus(loop, s.interface, s.channel, s.bitrate, s.data_bitrate)
        self._loop = loop
        self._began_ns = loop.now_ns()

    def ready(self, out: int, into: int) -> str:
        """With so many messages out of the devices, and into them."""
        s = self._settings
        kbits = "/".join(f"{rate / 1e3:g}" for rate in (s.bitrate, s.data_bitrate) if rate)
        return f"{s.channel}: {out} message{'s' * (out != 1)} out, {into} in, {kbits} kbit/s"

    def start(self, now_ns: int) -> None:
        """Count the load from now on."""
        self._began_ns = now_ns

    def inject(self, fault: Mapping[str, Any]) -> None:
        """Disturb the bus. Raises UsageError for what is no such fault, or where it isn't the test bus."""
        if not isinstance(self.line, CanHub):
            name = f"{self._settings.interface} {self._settings.channel}"
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
