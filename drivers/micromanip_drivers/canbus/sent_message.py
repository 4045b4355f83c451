"""A message that is sent to a device: values of outputs to frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import can
import numpy as np

from micromanip.driver import Channel, ConfigError, OutputRefused

from .bit_field import bit_field
from .database import identity, start_value, switches_bitrate, whole_number
from .options import Sent
from .plan import Outgoing, PackPlan


class SentMessage(Outgoing):
    """One message of cantools, with what the configuration says of it; its outputs begin at index `first`.

    Raises ConfigError for a counter that isn't there or doesn't count, and for a signal without a value to rest at.
    """

    def __init__(self, message: Any, options: Sent, first: int, frame_s: float) -> None:
        self.name: str = message.name
        self.identity = identity(message)
        self.frame_s = frame_s
        self.rate_hz = options.rate_hz
        key = f"send.{self.name}"
        counter = whole_number(f"{key}.counter", message, options.counter) if options.counter else None
        signals = [one for one in message.signals if one is not counter]
        if not signals:
            raise ConfigError(f"{key}: {self.name} has no signals but its counter")
        latency_s = frame_s if options.latency_us is None else options.latency_us * 1e-6
        self.outputs = [
            Channel(f"{self.name}.{one.name}", options.rate_hz, latency_s, safe=start_value(one)) for one in signals
        ]
        self.indices = tuple(range(first, first + len(signals)))
        self._slice = slice(first, first + len(signals))
        self.length: int = message.length
        self.fields = [bit_field(one, message.length) for one in signals]
        self.counter = bit_field(counter, message.length) if counter else None
        self._counting = np.zeros(1, [("count", "i8")])[0]
        self._plan = PackPlan([*self.fields, *([self.counter] if self.counter else [])], message.length)
        self._frame = {
            "arbitration_id": message.frame_id,
            "is_extended_id": message.is_extended_frame,
            "is_fd": message.is_fd,
            "bitrate_switch": message.is_fd and switches_bitrate(message),
        }
        self._must_rest(key)

    def frame(self, values: Sequence[float]) -> can.Message:
        """The next frame, with `values` of all outputs of the driver. Raises OutputRefused.

        Its counter stays until `was_sent`: a frame that the interface did not take leaves no gap.
        """
        own = values[self._slice]
        data = self._plan.data([*own, int(self._counting["count"])] if self.counter else own)
        return can.Message(data=data, **self._frame)

    def empty(self) -> can.Message:
        return can.Message(data=bytes(self.length), **self._frame)

    def count_in(self, record: Any) -> None:
        """Keep the counter in `record` from now on, where compiled code goes on with it."""
        record["count"] = self._counting["count"]
        self._counting = record

    def was_sent(self) -> None:
        """The last frame is on its way: count on."""
        if self.counter is not None:
            self._counting["count"] = (int(self._counting["count"]) + 1) & self.counter.mask

    def _must_rest(self, key: str) -> None:
        rest = [0.0] * self.indices[0] + [output.safe for output in self.outputs]
        try:
            self.frame(rest)
        except OutputRefused as error:
            raise ConfigError(f"{key}: {error}; give the signal a GenSigStartValue that it holds") from error
