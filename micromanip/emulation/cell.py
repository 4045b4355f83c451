"""What all emulated devices share: the plant, the amplifiers that move it, and what is wrong with its sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from micromanip.rt.record import MAX_AXES, record

from .amplifier import Amplifier
from .compiled import compiled
from .plant import PlantInRealTime

_EVERY_NS = 1_000_000
_TRUTH = {"path_error": "", "uncompensated": "uncompensated_"}
_MOST = len(_TRUTH) * MAX_AXES

PATH_ERRORS = record(
    ("due_ns", "i8"),
    ("count", "i8"),
    ("samples", "i8"),
    ("input", "i8", (_MOST,)),
    ("squares", "f8", (_MOST,)),
    ("largest", "f8", (_MOST,)),
)
"""Which inputs of the plant they are, when the next samples are due, and the sums over those that were taken."""


@compiled
def note_errors(e: Any, signals: Any, now_ns: int) -> None:
    """Take a sample of each, if it is time."""
    if now_ns < e["due_ns"]:
        return
    e["due_ns"] = now_ns + _EVERY_NS
    e["samples"] += 1
    inputs, squares, largest = e["input"], e["squares"], e["largest"]
    for i in range(e["count"]):
        value = signals[inputs[i]]["value"]
        squares[i] += value * value
        largest[i] = max(largest[i], abs(value))


class PathError:
    """Those of one plant."""

    def __init__(self, channels: Mapping[str, int]) -> None:
        """`channels` are the plant's inputs; those that it doesn't have are left out."""
        self.record = np.zeros(1, PATH_ERRORS)
        self._names = [name for name in channels if name.rsplit("_", 1)[0] in _TRUTH]
        self.record["count"] = len(self._names)
        self.record[0]["input"][: len(self._names)] = [channels[name] for name in self._names]
        self._errors = self.record[0]

    def report(self) -> dict[str, Any]:
        """By axis, since the start: rms, max, uncompensated_rms, uncompensated_max; None without samples."""
        axes: dict[str, Any] = {}
        samples = int(self._errors["samples"])
        for i, name in enumerate(self._names):
            quantity, axis = name.rsplit("_", 1)
            rms = math.sqrt(self._errors["squares"][i] / samples) if samples else None
            axes.setdefault(axis, {})[f"{_TRUTH[quantity]}rms"] = rms
            axes[axis][f"{_TRUTH[quantity]}max"] = float(self._errors["largest"][i]) if samples else None
        return axes


_AMPLIFIER_OK = "amplifier_ok"
_JUST_NS = 500_000


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
        self.errors = PathError(plant.inputs)

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
        self.look_after(clock_ns, now_ns)
        if self.wired_on and any(amplifier.is_commanded for amplifier in self.amplifiers):
            for name in self.wired_on:
                self.plant.write(name, 1.0)
            self.wired_on = ()
        self.plant.advance_to(now_ns)
        if now_ns >= self.errors.record[0]["due_ns"]:  # a call of compiled code takes longer than to look
            note_errors(self.errors.record[0], self.plant.arrays[1], now_ns)

    def keep_up(self, now_ns: int) -> None:
        """``advance_to``; but a plant that a message has just brought on stays there, for the next message waits."""
        if now_ns - self.plant.time_ns > _JUST_NS:
            self.advance_to(now_ns)
        else:
            self.look_after(now_ns, now_ns)

    def look_after(self, clock_ns: int, plant_ns: int) -> None:
        """Let the watchdogs of the amplifiers know the time."""
        for amplifier in self.amplifiers:
            amplifier.tick(clock_ns, plant_ns)

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
        """Outputs, switches and stalls since the last call, the rest since the start."""
        outputs: dict[str, Any] = {}
        switches: dict[str, Any] = {}
        for amplifier in self.amplifiers:
            analog, digital = amplifier.take_report()
            outputs, switches = outputs | analog, switches | digital
        return {
            "path_error_um": self.errors.report(),
            "outputs": outputs,
            "switches": switches,
            "amplifier_trips": sum(amplifier.trips for amplifier in self.amplifiers),
            "refused_commands": sum(amplifier.refused for amplifier in self.amplifiers),
            "stalls": self.plant.stalls.take_report(),
        }

    def _amplifier_ok(self, signal: str) -> float:
        """Of the amplifier that drives the signal's axis; of all of them for a signal without an axis."""
        voltage = "voltage" + signal.removeprefix(_AMPLIFIER_OK)
        concerned = [amplifier for amplifier in self.amplifiers if voltage in amplifier.rest_V] or self.amplifiers
        return float(all(amplifier.ok for amplifier in concerned))


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
