"""The address space: a node for each reading, made when it is first seen, and kept up to date."""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from typing import Any

from asyncua import Node, Server, ua

from ..readings import Reading

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
