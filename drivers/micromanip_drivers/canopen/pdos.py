"""Frames of a running bus: a PDO that comes to fresh samples, values to one that is sent."""

from __future__ import annotations

from collections.abc import Sequence

import can

from micromanip.driver import Channel, Inbox, TransientError

from ..canbus.bit_field import BitField
from ..canbus.plan import Incoming, Outgoing, PackPlan, UnpackPlan
from .plan import PdoPlan
from .sampling import Sampling


class ReceivedPdo(Incoming):
    """A TPDO of a node; its inputs begin at index `first`."""

    def __init__(self, pdo: PdoPlan, first: int, latency_s: float, sampling: Sampling) -> None:
        self.identity = (pdo.mapping.identifier, False)
        self.length, self.fields, self.first = pdo.mapping.length, pdo.wires, first
        self.latency_ns = 0  # that of each sampling is its own
        self.channels = [Channel(field.name, pdo.options.rate_hz, latency_s) for field in self.fields]
        self.sampling = sampling
        self.counters = dict.fromkeys(("pdos", "lost", "repeated", "short"), 0)
        self._title, self._plan = pdo.title, UnpackPlan(self.fields)

    def take(self, data: bytes, time_ns: int, inbox: Inbox) -> None:
        """Put the samples of a frame that was received at `time_ns` into `inbox`, if it is a fresh one.

        Raises TransientError for one that is too short.
        """
        if len(data) < self.length:
            self.counters["short"] += 1
            raise TransientError(f"{self._title} came with {len(data)} bytes; its mapping has {self.length}")
        data = data[: self.length]
        self.counters["pdos"] += 1
        taken = self.sampling.taken(time_ns, data)
        if taken is None:
            self.counters["repeated"] += 1
            return
        taken_ns, lost = taken
        self.counters["lost"] += lost
        inbox.put_all(self.first, self._plan.values(data), taken_ns, 0, lost)


class SentFrame(Outgoing):
    """A task: a frame that is `data`, with values in its `fields`; its outputs begin at index `first`."""

    def __init__(self, identifier: int, data: bytes, fields: Sequence[BitField] = (), first: int = 0) -> None:
        self.identity, self.length, self.fields = (identifier, False), len(data), fields
        self.indices = tuple(range(first, first + len(fields)))
        self._data, self._own = data, slice(first, first + len(fields))
        self._plan = PackPlan(fields, len(data))

    def frame(self, values: Sequence[float]) -> can.Message:
        """It, with `values` of all outputs of the driver. Raises OutputRefused."""
        return self._message(self._plan.data(values[self._own]) if self.fields else self._data)

    def empty(self) -> can.Message:
        return self._message(self._data)

    def _message(self, data: bytes) -> can.Message:
        return can.Message(arbitration_id=self.identity[0], data=data, is_extended_id=False)
