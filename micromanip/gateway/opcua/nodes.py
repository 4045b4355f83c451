"""The address space: a variable for each figure of a status, made when it is first seen, and kept up to date.

Names and places follow OPC 40501-1 (machine tools) 1.02 where it has some: Identification, Monitoring with MachineTool
and its OperationMode, Notification. The rest is ours. They were never held against the standard's official nodeset.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from asyncua import Node, Server, ua

from micromanip.status_reply import AxisValues, Status

from ..cell import Cell

MANUFACTURER = "micromanip"
Plain = bool | int | float | str | list[str]
_AUTOMATIC, _OTHER = 1, 5
"""OperationMode of OPC 40501-1."""
_IN_AUTOMATIC = ("ARMING", "TRACKING", "HOLDING")
_QUANTITIES = {
    "Position": ("position_um", "um"),
    "Setpoint": ("setpoint_um", "um"),
    "Strain": ("strain_um", "um"),
    "Voltage": ("voltage_V", "V"),
    "Headroom": ("headroom_V", "V"),
    "Error": ("error_um", "um"),
}
_WINDOW = {"Mean": "mean", "Min": "min", "Max": "max", "Rms": "rms", "Peak": "peak"}

_TYPES: dict[type, Any] = {
    bool: ua.VariantType.Boolean,
    int: ua.VariantType.Int64,
    float: ua.VariantType.Double,
    str: ua.VariantType.String,
    list: ua.VariantType.String,
}
_UNITS = {"um": ("4H", "µm", "micrometre"), "V": ("VLT", "V", "volt"), "Hz": ("HTZ", "Hz", "hertz"),
          "us": ("B98", "µs", "microsecond")}  # fmt: skip
"""By ours: common code of UNECE Recommendation 20, symbol, name."""
_UNECE = "http://www.opcfoundation.org/UA/units/un/cefact"


@dataclass(frozen=True)
class Reading:
    """One variable; `value` is None where it is not known now."""

    path: tuple[str, ...]
    kind: type[Plain] | type[list[str]]
    value: Plain | None
    unit: str | None = None


def readings(cell: Cell, version: str) -> Iterator[Reading]:
    """Everything there is to say now; without a controller only that there is none."""
    status = cell.status
    yield Reading(("Identification", "Manufacturer"), str, MANUFACTURER)
    yield Reading(("Identification", "SoftwareRevision"), str, version)
    yield Reading(("Monitoring", "Connected"), bool, status is not None)
    yield Reading(("Monitoring", "Problem"), str, cell.problem or "")
    if status is not None:
        yield from _of_cell(status)
        for axis, values in status["axes"].items():
            yield from _of_axis(axis, values)
        yield from _of_signals(status)


def _of_cell(status: Status) -> Iterator[Reading]:
    state = status["state"]
    yield Reading(("Identification", "Configuration"), str, status["configuration"])
    yield Reading(("Identification", "ConfigurationSha256"), str, status["configuration_sha256"])
    mode = _AUTOMATIC if state in _IN_AUTOMATIC else _OTHER
    yield Reading(("Monitoring", "MachineTool", "OperationMode"), int, mode)
    yield Reading(("Monitoring", "State"), str, state)
    yield Reading(("Monitoring", "FaultActive"), bool, bool(status["fault_reports"]))
    yield Reading(("Monitoring", "ParameterVersion"), int, status["parameter_version"])
    yield Reading(("Monitoring", "Recording"), bool, status["recording"] is not None)
    yield Reading(("Monitoring", "Timing", "Cycles"), int, status["cycles"])
    yield Reading(("Monitoring", "Timing", "Overruns"), int, status["overruns"])
    for name, durations in (("Lateness", status["lateness_ns"]), ("Compute", status["compute_ns"])):
        for figure, ns in (("P50", durations["p50"]), ("P99_9", durations["p99_9"]), ("Max", durations["max"])):
            yield Reading(("Monitoring", "Timing", name + figure), float, ns * 1e-3, "us")
    yield Reading(("Notification", "Faults"), list, list(status["faults"]))
    yield Reading(("Notification", "NextSteps"), list, [fault["next_step"] for fault in status["fault_reports"]])
    for name, link in status["links"].items():
        yield Reading(("Monitoring", "Links", name), bool, link["link"] == "up")


def _of_axis(axis: str, values: AxisValues) -> Iterator[Reading]:
    place = ("Monitoring", "Axes", axis)
    for name, (key, unit) in _QUANTITIES.items():
        value = values[key]  # type: ignore[literal-required]
        yield Reading((*place, name), float, value["latest"], unit)
        for window in ("second", "minute"):
            for figure, field in _WINDOW.items():
                known = value[window]
                called = f"{name}{figure}Last{window.capitalize()}"
                yield Reading((*place, called), float, None if known is None else known[field], unit)
    yield Reading((*place, "ErrorOf"), str, values["error_of"] or "")


def _of_signals(status: Status) -> Iterator[Reading]:
    for name, signal in status["signals"].items():
        place = ("Monitoring", "Signals", name)
        yield Reading((*place, "Rate"), float, signal["rate_hz"], "Hz")
        for figure, key in (("AgeP50", "age_p50_us"), ("AgeMax", "age_max_us")):
            age = signal[key]  # type: ignore[literal-required]
            yield Reading((*place, figure), float, None if age is None else float(age), "us")
        yield Reading((*place, "Lost"), int, signal["lost"])
        yield Reading((*place, "Superseded"), int, signal["superseded"])
        yield Reading((*place, "Refused"), int, signal["refused"])
        yield Reading((*place, "StaleCycles"), int, signal["stale_cycles"])


class Nodes:
    """Variables below one object, by their paths; node ids are strings, ``cell/Monitoring/Axes/x/Position``."""

    def __init__(self, server: Server, index: int, cell: Node) -> None:
        """`index` is that of our namespace, `cell` the object that holds everything."""
        self._server, self._index = server, index
        self._objects: dict[tuple[str, ...], Node] = {(): cell}
        self._variables: dict[tuple[str, ...], ua.NodeId] = {}
        self._shown: dict[tuple[str, ...], Any] = {}

    async def show(self, readings: Iterable[Reading]) -> None:
        """Write what has changed; what is not among `readings` any more is marked as not known."""
        now = datetime.datetime.now(datetime.UTC)
        found = {reading.path: reading for reading in readings}
        for path, reading in found.items():
            if path not in self._variables:
                await self._make(reading)
            if self._shown.get(path, self) != reading.value:
                await self._write(path, _data(reading, now))
                self._shown[path] = reading.value
        for path in [path for path in self._shown if path not in found]:
            lost = ua.DataValue(ua.Variant(None), ua.StatusCode(ua.StatusCodes.BadNoCommunication), now, now)
            await self._write(path, lost)
            del self._shown[path]

    async def _write(self, path: tuple[str, ...], value: ua.DataValue) -> None:
        await self._server.write_attribute_value(self._variables[path], value)

    async def _object(self, path: tuple[str, ...]) -> Node:
        if path not in self._objects:
            above = await self._object(path[:-1])
            name = ua.QualifiedName(path[-1], self._index)
            self._objects[path] = await above.add_object(self._id(path), name)
        return self._objects[path]

    async def _make(self, reading: Reading) -> None:
        above = await self._object(reading.path[:-1])
        kind = _TYPES[reading.kind]
        name = ua.QualifiedName(reading.path[-1], self._index)
        empty: Any = [] if reading.kind is list else reading.kind()
        variable = await above.add_variable(self._id(reading.path), name, empty, kind)
        if reading.kind is list:
            await variable.write_value_rank(ua.ValueRank.OneDimension)
        if reading.unit is not None:
            code, symbol, called = _UNITS[reading.unit]
            number = int.from_bytes(code.encode(), "big")
            unit = ua.EUInformation(_UNECE, number, ua.LocalizedText(symbol), ua.LocalizedText(called))
            await variable.add_property(
                self._id((*reading.path, "EngineeringUnits")), ua.QualifiedName("EngineeringUnits", 0), unit
            )
        self._variables[reading.path] = variable.nodeid

    def _id(self, path: tuple[str, ...]) -> ua.NodeId:
        return ua.NodeId("/".join(("cell", *path)), self._index)


def _data(reading: Reading, now: datetime.datetime) -> ua.DataValue:
    if reading.value is None:
        return ua.DataValue(ua.Variant(None), ua.StatusCode(ua.StatusCodes.BadNoData), now, now)
    return ua.DataValue(ua.Variant(reading.value, _TYPES[reading.kind]), None, now, now)
