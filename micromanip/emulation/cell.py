"""What all emulated devices share: the plant, the amplifiers that move it, and what is wrong with its sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from .amplifier import Amplifier, Arrived
from .plant import PlantInRealTime

_AMPLIFIER_OK = "amplifier_ok"
_EVERY_NS = 1_000_000
_TRUTH = {"path_error": "", "uncompensated": "uncompensated_"}


class EmulatedCell:
    """Devices call `advance_to` before they read and after they wrote; signals go by the configuration's names."""

    def __init__(self, plant: PlantInRealTime, clock: Callable[[], int]) -> None:
        """`clock` tells CLOCK_MONOTONIC; the plant may be behind it, where a late device makes up for it."""
        self.plant = plant
        self.clock = clock
        self.amplifiers: list[Amplifier] = []
        self.faults = SignalFaults()
        self.wired_on: tuple[str, ...] = ()
        """Switches of the plant that nobody switches; on from the first command on, when work may begin."""
        self._errors = PathError(plant.inputs)
        self._errors_since_report = PathError(plant.inputs)

    def has(self, signal: str) -> bool:
        """Whether `read` knows a signal."""
        return signal in self.plant.inputs or signal.startswith(_AMPLIFIER_OK)

    @property
    def undisturbed(self) -> bool:
        """Whether amplifiers follow and sensors are as they should be: compiled code may serve a device."""
        return not self.faults.any and not self.wired_on and all(amplifier.follows for amplifier in self.amplifiers)

    def advance_to(self, now_ns: int) -> None:
        """Let time pass in plant and amplifiers."""
        clock_ns = self.clock()
        self.plant.stalls.behind(clock_ns - now_ns)
        for amplifier in self.amplifiers:
            amplifier.tick(clock_ns, now_ns)
        if self.wired_on and any(amplifier.is_commanded for amplifier in self.amplifiers):
            for name in self.wired_on:
                self.plant.write(name, 1.0)
            self.wired_on = ()
        self.plant.advance_to(now_ns)
        if self._errors.due(now_ns):
            for name in self._errors.names:
                value = self.plant.value(name)
                self._errors.add(name, value)
                self._errors_since_report.add(name, value)

    def read(self, signal: str) -> float:
        """What its sensor says: NaN where that is spoiled; 0 for one that the plant doesn't have."""
        value = self.plant.value(signal) if signal in self.plant.inputs else float(signal.startswith(_AMPLIFIER_OK))
        if signal.startswith(_AMPLIFIER_OK):
            value *= self._amplifier_ok(signal)
        return self.faults.spoiled(signal, value, self.plant.time_ns) if self.faults.any else value

    def voltages(self) -> dict[str, float]:
        """What the amplifiers put out, by the outputs' names."""
        return {name: volts for amplifier in self.amplifiers for name, volts in amplifier.in_force.items()}

    def report(self) -> dict[str, Any]:
        """Figures since the start."""
        return {
            "path_error_um": self._errors.report(),
            "outputs": self._outputs(lambda amplifier: amplifier.arrived),
            "switches": self._outputs(lambda amplifier: amplifier.switches),
            "amplifier_trips": sum(amplifier.trips for amplifier in self.amplifiers),
            "refused_commands": sum(amplifier.refused for amplifier in self.amplifiers),
            "stalls": self.plant.stalls.report(),
        }

    def report_since_last(self) -> dict[str, Any]:
        """Path error, outputs and the latest event since the last call, the rest since the start."""
        report = self.report()
        self.plant.stalls.latest_ms = 0.0
        report["path_error_um"] = self._errors_since_report.report()
        report["outputs"] = self._outputs(Amplifier.take_report)
        report["switches"] = self._outputs(Amplifier.take_switches)
        self._errors_since_report = PathError(self.plant.inputs)
        return report

    def _amplifier_ok(self, signal: str) -> float:
        """Of the amplifier that drives the signal's axis; of all of them for a signal without an axis."""
        voltage = "voltage" + signal.removeprefix(_AMPLIFIER_OK)
        concerned = [amplifier for amplifier in self.amplifiers if voltage in amplifier.rest_V] or self.amplifiers
        return float(all(amplifier.ok for amplifier in concerned))

    def _outputs(self, figures: Any) -> dict[str, Any]:
        merged: Mapping[str, Arrived] = {}
        for amplifier in self.amplifiers:
            merged = {**merged, **figures(amplifier)}
        return {name: arrived.report() for name, arrived in merged.items()}


@dataclass
class SignalFault:
    """One fault of one signal; `value` in the signal's unit, for a drift per second."""

    kind: str
    """freeze, offset, drift, nan."""
    value: float
    since_ns: int
    until_ns: int | None
    held: float | None = None


class SignalFaults:
    """Spoils readings by signal name. The last fault given to a signal replaces the one before."""

    def __init__(self) -> None:
        self._faults: dict[str, SignalFault] = {}

    def begin(self, signal: str, kind: str, value: float, now_ns: int, for_s: float | None) -> None:
        """From now on; None is for ever."""
        until_ns = None if for_s is None else now_ns + round(for_s * 1e9)
        self._faults[signal] = SignalFault(kind, value, now_ns, until_ns)

    @property
    def any(self) -> bool:
        """Whether there is one at all."""
        return bool(self._faults)

    def clear(self) -> None:
        """End them all."""
        self._faults.clear()

    def spoiled(self, signal: str, value: float, now_ns: int) -> float:
        """What is read of `signal` in place of `value`."""
        fault = self._faults.get(signal)
        if fault is None:
            return value
        if fault.until_ns is not None and now_ns >= fault.until_ns:
            del self._faults[signal]
            return value
        match fault.kind:
            case "freeze":
                fault.held = value if fault.held is None else fault.held
                return fault.held
            case "offset":
                return value + fault.value
            case "drift":
                return value + fault.value * (now_ns - fault.since_ns) * 1e-9
        return math.nan


@dataclass
class Figures:
    """Of one quantity over time."""

    samples: int = 0
    squares: float = 0.0
    largest: float = 0.0

    def add(self, value: float) -> None:
        """One more sample."""
        self.samples += 1
        self.squares += value * value
        self.largest = max(self.largest, abs(value))

    @property
    def rms(self) -> float | None:
        """Root mean square; None without samples."""
        return math.sqrt(self.squares / self.samples) if self.samples else None


class PathError:
    """Figures of ``path_error_<axis>`` and ``uncompensated_<axis>``, a sample a millisecond."""

    def __init__(self, channels: dict[str, int]) -> None:
        """`channels` are the plant's inputs; those that it doesn't have are left out."""
        self.names = [name for name in channels if name.rsplit("_", 1)[0] in _TRUTH]
        self._figures = {name: Figures() for name in self.names}
        self._due_ns = 0

    def due(self, now_ns: int) -> bool:
        """Whether it is time for the next samples."""
        if now_ns < self._due_ns:
            return False
        self._due_ns = now_ns + _EVERY_NS
        return True

    def add(self, name: str, value: float) -> None:
        """A sample of one of `names`."""
        self._figures[name].add(value)

    def report(self) -> dict[str, Any]:
        """By axis: rms, max, uncompensated_rms, uncompensated_max."""
        axes: dict[str, Any] = {}
        for name, figures in self._figures.items():
            quantity, axis = name.rsplit("_", 1)
            axes.setdefault(axis, {})[f"{_TRUTH[quantity]}rms"] = figures.rms
            axes[axis][f"{_TRUTH[quantity]}max"] = figures.largest if figures.samples else None
        return axes
