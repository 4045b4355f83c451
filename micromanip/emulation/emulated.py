"""What stands between a command line and any played device, whatever its protocol."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.source import Source
from micromanip.testbus.event_loop import EventLoop

from .amplifier import Amplifier
from .cell import PlayedCell
from .wires import Wires

_MISSED_PERIODS = 5
"""An amplifier that is commanded slowly has a watchdog to match: it forgives so many commands that don't come."""


@dataclass(frozen=True)
class Surroundings:
    """What a builder of devices gets."""

    configuration: Configuration
    source: Source
    loop: EventLoop
    cell: PlayedCell
    watchdog_ms: float

    def amplifier(self, wires: Wires, period_ms: float = 0.0) -> Amplifier | None:
        """The amplifier behind the outputs of a driver, commanded every `period_ms` at least; None without outputs."""
        if not wires.outputs:
            return None
        watchdog_ms = max(self.watchdog_ms, _MISSED_PERIODS * period_ms)
        amplifier = Amplifier(self.cell.plant, wires.rest_V, watchdog_ms)
        self.cell.amplifiers.append(amplifier)
        return amplifier


class PlayedDevice(Protocol):
    """The device, or devices, behind one driver of the configuration."""

    @property
    def ready(self) -> str:
        """What it says when it is up: "can0: 2 messages out, 1 in, 1000/5000 kbit/s"."""

    @property
    def signals(self) -> list[str]:
        """What it measures, by the names that commands use."""

    @property
    def messages(self) -> list[str]:
        """What it sends."""

    def start(self, now_ns: int) -> None:
        """Begin to talk."""

    def stop_counter(self, message: str, for_s: float | None) -> None:
        """Let the counter of one of `messages` stand still; None is until ``clear``."""

    def silence(self, message: str, for_s: float | None) -> None:
        """Don't send one of `messages`; None is until ``clear``."""

    def reboot(self, for_s: float) -> None:
        """Be off for so long, then begin anew."""

    def inject(self, fault: Mapping[str, Any]) -> None:
        """Disturb the line itself; UsageError or ConfigError where it can't be."""

    def clear(self) -> None:
        """End what was begun by the four above."""

    def report(self) -> dict[str, Any]:
        """Frames, load and errors since the start."""

    def close(self) -> None:
        """Let go of the line."""


Builder = Callable[[str, Surroundings], PlayedDevice]
"""Builds what is behind the driver of that name in the configuration; raises ConfigError or DeviceUnavailable."""
