"""What an edge node says: births with names and types, then changes by alias, deaths; without a network.

The cell is the node, each axis a device. A message is a topic and a payload. One `EdgeNode` is one session with the
broker: its `bdSeq` stands in the will that the broker has, and in each birth.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from ..readings import Reading
from .options import Options
from .schema import BOOLEAN, DOUBLE, INT64, STRING, Payload

NAMESPACE = "spBv1.0"
REBIRTH = "Node Control/Rebirth"
NUMBERS = 256
"""Of `seq` and `bdSeq`, which begin again at 0."""
_AXES = ("Monitoring", "Axes")
_FIELDS = {BOOLEAN: "boolean_value", INT64: "long_value", DOUBLE: "double_value", STRING: "string_value"}
_TYPES: dict[type, int] = {bool: BOOLEAN, int: INT64, float: DOUBLE, str: STRING, list: STRING}

Value = bool | int | float | str | None


class Message(NamedTuple):
    """To be published."""

    topic: str
    payload: bytes


class Metric(NamedTuple):
    """A reading as a metric of a device, or with "" of the node."""

    device: str
    name: str
    datatype: int
    value: Value
    unit: str | None

    @classmethod
    def of(cls, reading: Reading) -> Metric:
        """A list is its lines; what is no finite number is not known."""
        is_axis = reading.path[: len(_AXES)] == _AXES
        device, name = (reading.path[2], reading.path[3:]) if is_axis else ("", reading.path)
        value = "\n".join(reading.value) if isinstance(reading.value, list) else reading.value
        if reading.kind is float and isinstance(value, int | float):
            value = float(value) if math.isfinite(value) else None
        return cls(device, "/".join(name), _TYPES[reading.kind], value, reading.unit)


class EdgeNode:
    """One session."""

    def __init__(self, options: Options, bd_seq: int) -> None:
        """`bd_seq` is 0 to 255, one more than in the session before."""
        self._options, self._bd_seq = options, bd_seq
        self._deadbands: Mapping[str | None, float] = {None: 0.0} | options.deadbands.model_dump()
        self._seq = 0
        self._aliases: dict[tuple[str, str], int] = {}
        self._types: dict[tuple[str, str], int] = {}
        self._sent: dict[tuple[str, str], Value] = {}
        self._alive: set[str] = set()

    def topic(self, kind: str, device: str = "") -> str:
        """Of messages of one kind."""
        end = f"/{device}" if device else ""
        return f"{NAMESPACE}/{self._options.group}/{kind}/{self._options.node}{end}"

    def death(self, now_ms: int) -> Message:
        """The will; a node that leaves by itself says the same."""
        payload = Payload(timestamp=now_ms)
        _add(payload, "bdSeq", INT64, self._bd_seq, now_ms)
        return Message(self.topic("NDEATH"), payload.SerializeToString())

    def birth(self, readings: Iterable[Reading], now_ms: int) -> Iterator[Message]:
        """Everything, with names, types, units and aliases: the node, and each axis that is known."""
        metrics = [Metric.of(reading) for reading in readings]
        self._seq, self._sent, self._alive = 0, {}, set()
        payload = Payload(timestamp=now_ms)
        _add(payload, "bdSeq", INT64, self._bd_seq, now_ms)
        _add(payload, REBIRTH, BOOLEAN, False, now_ms)
        yield self._born("", [metric for metric in metrics if not metric.device], payload, now_ms)
        for device in dict.fromkeys(metric.device for metric in metrics if metric.device):
            yield self._born(device, [metric for metric in metrics if metric.device == device], None, now_ms)

    def changes(self, readings: Iterable[Reading], now_ms: int) -> Iterator[Message]:
        """What has changed by its deadband or more since it was sent; all anew where there is something new to name."""
        readings = list(readings)
        found: dict[str, list[Metric]] = {"": []}
        for metric in map(Metric.of, readings):
            found.setdefault(metric.device, []).append(metric)
        if any((device, metric.name) not in self._aliases for device in found for metric in found[device]):
            yield from self.birth(readings, now_ms)
            return
        for device in sorted(self._alive - found.keys()):
            yield self._message("DDEATH", device, Payload(timestamp=now_ms))
            self._alive.discard(device)
        for device, metrics in found.items():
            if device and device not in self._alive:
                yield self._born(device, metrics, None, now_ms)
            else:
                yield from self._data(device, metrics, now_ms)

    def _born(self, device: str, metrics: list[Metric], payload: Any, now_ms: int) -> Message:
        payload = Payload(timestamp=now_ms) if payload is None else payload
        for metric in metrics:
            key = (device, metric.name)
            made = _add(payload, metric.name, metric.datatype, metric.value, now_ms)
            made.alias = self._aliases.setdefault(key, len(self._aliases) + 1)
            if metric.unit is not None:
                made.properties.keys.append("engUnit")
                made.properties.values.add(type=STRING, string_value=metric.unit)
            self._types[key], self._sent[key] = metric.datatype, metric.value
        if device:
            self._alive.add(device)
        return self._message("DBIRTH" if device else "NBIRTH", device, payload)

    def _data(self, device: str, metrics: list[Metric], now_ms: int) -> Iterator[Message]:
        """What has changed; a metric of the node that nobody knows now is null.

        The standard would have types in births alone (SHOULD), but many hosts read no value without one.
        """
        known = {metric.name: metric for metric in metrics}
        payload = Payload(timestamp=now_ms)
        for key, sent in self._sent.items():
            of, name = key
            if of != device:
                continue
            metric = known.get(name)
            value = None if metric is None else metric.value
            if _differs(value, sent, self._deadbands[None if metric is None else metric.unit]):
                made = payload.metrics.add(alias=self._aliases[key], datatype=self._types[key], timestamp=now_ms)
                _put(made, value)
                self._sent[key] = value
        if payload.metrics:
            yield self._message("DDATA" if device else "NDATA", device, payload)

    def _message(self, kind: str, device: str, payload: Any) -> Message:
        payload.seq = self._seq
        self._seq = (self._seq + 1) % NUMBERS
        return Message(self.topic(kind, device), payload.SerializeToString())


def _add(payload: Any, name: str, datatype: int, value: Value, now_ms: int) -> Any:
    made = payload.metrics.add(name=name, datatype=datatype, timestamp=now_ms)
    _put(made, value)
    return made


def _put(made: Any, value: Value) -> None:
    if value is None:
        made.is_null = True
    else:
        field = _FIELDS[_TYPES[type(value)]]
        setattr(made, field, value % 2**64 if field == "long_value" else value)


def _differs(value: Value, sent: Value, deadband: float) -> bool:
    if isinstance(value, float) and isinstance(sent, float):
        return value != sent and abs(value - sent) >= deadband
    return value != sent
