"""What stands between a command line and any emulated device, whatever its protocol."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from micromanip.bus.cyclic import CyclicDriver
from micromanip.errors import nearest
from micromanip.settings.schema.model import Configuration, Output, Switch
from micromanip.settings.text.source import Source
from micromanip.settings.wiring.places import build_driver
from micromanip.testbus.event_loop import EventLoop

from .amplifier import Amplifier
from .cell import EmulatedCell

_MISSED_PERIODS = 5
"""An amplifier that is commanded slowly has a watchdog to match: it forgives so many commands that don't come."""

_WITHOUT_PLANT = ("amplifier_reset",)
"""Switches that act on the device alone."""


@dataclass(frozen=True)
class Wires:
    """Of one driver: channel of the driver to name in the configuration, and the voltages at rest by that name."""

    signals: dict[str, str]
    outputs: dict[str, str]
    rest_V: dict[str, float]


@dataclass(frozen=True)
class Surroundings:
    """What a builder of devices gets."""

    configuration: Configuration
    source: Source
    loop: EventLoop
    cell: EmulatedCell
    watchdog_ms: float

    def options(self, driver: str) -> Any:
        """The keys of a driver, as of `built`: validated, with their defaults, by attribute."""
        return self.built(driver)[1]

    def built(self, driver: str) -> tuple[CyclicDriver, Any]:
        """A driver as for a run, and its keys. Raises ConfigError, at file, line and key, for what it would refuse."""
        silent_ns = round(self.configuration.faults.link.silent_ms * 1e6)
        entry = self.configuration.drivers[driver]
        return build_driver(self.source, driver, entry, self.configuration.loop.period_ns, silent_ns)

    def wires(self, driver: str) -> Wires:
        """What the configuration connects to `driver`; ConfigError with file and line for what the plant lacks."""
        signals = {
            entry.channel or name: name for name, entry in self.configuration.signals.items() if entry.driver == driver
        }
        for name in signals.values():
            if not self.cell.has(name):
                raise self.source.error(("signals", name), _missing(name, self.cell.plant.inputs))
        written: dict[str, tuple[str, Output | Switch]] = {
            name: ("outputs", output) for name, output in self.configuration.outputs.items()
        }
        for name in type(self.configuration.switches).model_fields:
            switch = getattr(self.configuration.switches, name)
            if switch is not None:
                written[name] = ("switches", switch)
        outputs = {}
        for name, (section, entry) in written.items():
            if entry.driver == driver and name not in _WITHOUT_PLANT:
                if name not in self.cell.plant.outputs:
                    raise self.source.error((section, name), _missing(name, self.cell.plant.outputs))
                outputs[entry.channel or name] = name
        rest_V = {name: output.park_V for name, output in self.configuration.outputs.items() if output.driver == driver}
        return Wires(signals, outputs, rest_V)

    def amplifier(self, wires: Wires, rates_hz: Iterable[float] = ()) -> Amplifier | None:
        """The amplifier behind the outputs of a driver, commanded at these rates; None without outputs."""
        if not wires.outputs:
            return None
        watchdog_ms = max([self.watchdog_ms, *(_MISSED_PERIODS * 1e3 / rate_hz for rate_hz in rates_hz)])
        amplifier = Amplifier(self.cell.plant, wires.rest_V, watchdog_ms)
        self.cell.amplifiers.append(amplifier)
        return amplifier


class EmulatedDevice(Protocol):
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


Builder = Callable[[str, Surroundings], EmulatedDevice]
"""Builds what is behind the driver of that name in the configuration; raises ConfigError or DeviceUnavailable."""


def _missing(name: str, known: Iterable[str]) -> str:
    near = nearest(name, known)
    hint = f"did you mean {near}?" if near else "digital lines exist with `simulation: {lines: {}}`"
    return f"the simulated plant has no {name}, which the emulated devices need; {hint}"
