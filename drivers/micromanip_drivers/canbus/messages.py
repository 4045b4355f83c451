"""Messages of a DBC: frames of a device to fresh samples of its signals, values of outputs to frames."""

from __future__ import annotations

from typing import Any

from micromanip.driver import Channel, ConfigError, Inbox, OutputRefused
from micromanip.driver.wire import DeviceCounter

from ..line.frame_options import BAD
from .database import counts, identity, start_value, switches_bitrate, whole_number
from .options import Received, Sent
from .plan import Incoming, Outgoing, UnpackPlan, bit_field


class ReceivedMessage(Incoming):
    """One message of cantools, with what the configuration says of it; its inputs begin at index `first`.

    Raises ConfigError for a counter or status signal that isn't there or doesn't count.
    """

    def __init__(self, message: Any, options: Received, first: int, frame_s: float) -> None:
        self.title: str = message.name
        self.identity = identity(message)
        self.length: int = message.length
        self.frame_s = frame_s
        self.rate_hz = options.rate_hz
        self.latency_ns = round(frame_s * 1e9 if options.latency_us is None else options.latency_us * 1e3)
        self.first = first
        key = f"receive.{self.title}"
        own = [whole_number(f"{key}.counter", message, options.counter)] if options.counter else []
        if options.status:
            own.append(whole_number(f"{key}.status.signal", message, options.status.signal))
        self.good = frozenset(options.status.good) if options.status else None
        values = [one for one in message.signals if one not in own]
        if not values:
            raise ConfigError(f"{key}: {self.title} has no signals but its counter and status")
        self.counter = DeviceCounter(counts(own[0])) if options.counter else None
        self.own = [bit_field(one, self.length) for one in own]
        """Its counter and its status, as far as it has them."""
        self.fields = [bit_field(one, self.length) for one in values]
        self._own, self._values = UnpackPlan(self.own), UnpackPlan(self.fields)
        self.inputs = [
            Channel(f"{self.title}.{one.name}", options.rate_hz, latency_s=self.latency_ns * 1e-9) for one in values
        ]

    def take(self, data: bytes | bytearray, time_ns: int, inbox: Inbox) -> None:
        """Put the samples of a frame that was received at `time_ns` into `inbox`, if it is a fresh one.

        Raises TransientError for a frame that is too short to be the message.
        """
        data = self.whole(data)
        own = self._own.codes(data)
        lost = self.counter.lost_before(own[0]) if self.counter else 0
        if lost is None:
            return
        status = 0
        if self.good is not None and own[-1] not in self.good:
            status = own[-1] or BAD
        inbox.put_all(self.first, self._values.values(data), time_ns - self.latency_ns, status, lost)


class SentMessage(Outgoing):
    """One message of cantools, with what the configuration says of it; its outputs begin at index `first`.

    Raises ConfigError for a counter that isn't there or doesn't count, and for a signal without a value to rest at.
    """

    def __init__(self, message: Any, options: Sent, first: int, frame_s: float) -> None:
        self.name: str = message.name
        self.frame_s = frame_s
        self.rate_hz = options.rate_hz
        key, length = f"send.{self.name}", message.length
        counter = whole_number(f"{key}.counter", message, options.counter) if options.counter else None
        signals = [one for one in message.signals if one is not counter]
        if not signals:
            raise ConfigError(f"{key}: {self.name} has no signals but its counter")
        super().__init__(
            identity(message),
            bytes(length),
            [bit_field(one, length) for one in signals],
            first,
            bit_field(counter, length) if counter else None,
            counts(counter) if counter else 0,
            is_fd=message.is_fd,
            bitrate_switch=message.is_fd and switches_bitrate(message),
        )
        latency_s = frame_s if options.latency_us is None else options.latency_us * 1e-6
        self.outputs = [
            Channel(f"{self.name}.{one.name}", options.rate_hz, latency_s, safe=start_value(one)) for one in signals
        ]
        try:
            self.frame([0.0] * first + [output.safe for output in self.outputs])
        except OutputRefused as error:
            raise ConfigError(f"{key}: {error}; give the signal a GenSigStartValue that it holds") from error
