"""A message that a device sends: frames to fresh samples of its signals."""

from __future__ import annotations

from typing import Any

from micromanip.driver import Channel, ConfigError, Inbox, TransientError

from .bit_field import bit_field
from .database import identity, whole_number
from .options import Received
from .plan import UnpackPlan

_BAD = -1
"""Status of samples whose device says 0, and 0 is not good."""
_RESTARTED_AFTER = 3
"""So many frames in a row that go on from a count in the past: the device began anew, it is no reordering."""


class ReceivedMessage:
    """One message of cantools, with what the configuration says of it; its inputs begin at index `first`.

    Raises ConfigError for a counter or status signal that isn't there or doesn't count.
    """

    def __init__(self, message: Any, options: Received, first: int, frame_s: float) -> None:
        self.name: str = message.name
        self.identity = identity(message)
        self.length: int = message.length
        self.frame_s = frame_s
        self.rate_hz = options.rate_hz
        self.short = 0
        self._latency_ns = round(frame_s * 1e9 if options.latency_us is None else options.latency_us * 1e3)
        self._first = first
        key = f"receive.{self.name}"
        own = [whole_number(f"{key}.counter", message, options.counter)] if options.counter else []
        if options.status:
            own.append(whole_number(f"{key}.status.signal", message, options.status.signal))
        self._good = frozenset(options.status.good) if options.status else None
        values = [one for one in message.signals if one not in own]
        if not values:
            raise ConfigError(f"{key}: {self.name} has no signals but its counter and status")
        self.counter = FrameCounter(own[0].length) if options.counter else None
        self._own = UnpackPlan([bit_field(one, self.length) for one in own])
        self._values = UnpackPlan([bit_field(one, self.length) for one in values])
        self.inputs = [
            Channel(f"{self.name}.{one.name}", options.rate_hz, latency_s=self._latency_ns * 1e-9) for one in values
        ]

    def take(self, data: bytes | bytearray, time_ns: int, inbox: Inbox) -> None:
        """Put the samples of a frame that was received at `time_ns` into `inbox`, if it is a fresh one.

        Raises TransientError for a frame that is too short to be the message.
        """
        if len(data) != self.length:
            if len(data) < self.length:
                self.short += 1
                raise TransientError(f"{self.name} came with {len(data)} bytes, the database says {self.length}")
            data = data[: self.length]
        own = self._own.codes(data)
        lost = self.counter.lost_before(own[0]) if self.counter else 0
        if lost is None:
            return
        status = 0
        if self._good is not None and own[-1] not in self._good:
            status = own[-1] or _BAD
        inbox.put_all(self._first, self._values.values(data), time_ns - self._latency_ns, status, lost)


class FrameCounter:
    """Follows the counter of one message.

    A count that was there already is no news: the device repeats itself, or is frozen. One from the past, by less than
    half of the counter's range, was overtaken on its way. Neither is a fresh sample.
    """

    def __init__(self, bits: int) -> None:
        self._modulus = 1 << bits
        self._last: int | None = None
        self._past: int | None = None
        self._in_order = 0
        self.lost = self.repeated = self.out_of_order = self.restarts = 0

    def forget(self) -> None:
        """Begin anew: what comes next is taken as it is."""
        self._last = self._past = None

    def lost_before(self, count: int) -> int | None:
        """Frames known to be missing before the one with this count; None for a frame that is not fresh."""
        if self._last is None:
            self._last = count
            return 0
        ahead = (count - self._last) % self._modulus
        if ahead == 0:
            self.repeated += 1
            return None
        if ahead > self._modulus // 2:
            return self._from_the_past(count)
        self._last, self._past = count, None
        self.lost += ahead - 1
        return ahead - 1

    def _from_the_past(self, count: int) -> int | None:
        goes_on = self._past is not None and count == (self._past + 1) % self._modulus
        self._in_order = self._in_order + 1 if goes_on else 1
        self._past = count
        if self._in_order <= _RESTARTED_AFTER:
            self.out_of_order += 1
            return None
        self.restarts += 1
        self._last, self._past = count, None
        return 0
