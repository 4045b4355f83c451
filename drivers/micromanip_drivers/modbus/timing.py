"""What transactions cost of the line, and how old values are by them."""

from __future__ import annotations

from collections.abc import Iterable

from micromanip.driver import ConfigError, Load

from .exchange import Exchange
from .framing import RtuFraming, TcpFraming
from .options import ModbusOptions
from .plan import TaskPlan

_ETHERNET_BITS = (14 + 20 + 20 + 4 + 8 + 12) * 8
"""Of a packet beside its Modbus frame: Ethernet, IP and TCP, with preamble and gap."""
_LEAST_ETHERNET_BITS = 84 * 8
_GAP_CHARACTERS, _LEAST_GAP_S = 3.5, 1.75e-3
"""Silence between the frames of a serial line; the least is for rates above 19200 baud."""
_FAST_BAUD = 19_200
_LIMIT = 0.9
"""A polled line has one master and no collisions: it may be filled further than a bus that several share."""


class Timing:
    """Of all transactions, at worst."""

    def __init__(self, options: ModbusOptions) -> None:
        self._options = options
        self._response_s = options.response_ms * 1e-3
        self.gap_s = 0.0
        """Silence before each request."""
        if serial := options.serial:
            gap_s = _GAP_CHARACTERS * serial.bits_per_byte / serial.baud
            own_s = serial.rs485.turnaround_us * 1e-6 if serial.rs485 else 0.0
            self.gap_s = max(own_s, gap_s if serial.baud <= _FAST_BAUD else _LEAST_GAP_S)

    def request_s(self, exchange: Exchange) -> float:
        """The request on the wire."""
        return self._wire_s(exchange.request_bytes)

    def answer_s(self, exchange: Exchange) -> float:
        """The answer on the wire."""
        return self._wire_s(exchange.answer_bytes)

    def taken_s(self, exchange: Exchange) -> float:
        """From the beginning of the request to the end of the answer."""
        return self.request_s(exchange) + self._response_s + self.answer_s(exchange)

    def busy_s(self, exchange: Exchange) -> float:
        """For how long it keeps the line: a serial one is silent after each frame."""
        return self.taken_s(exchange) + 2.0 * self.gap_s

    def input_latency_s(self, plan: TaskPlan) -> float:
        """From being asked for to being received: half of the response time is between the two, on the average."""
        return 0.5 * self._response_s + max(map(self.answer_s, plan.exchanges))

    def output_latency_s(self, plan: TaskPlan) -> float:
        """From being sent to being taken by the device."""
        before_s = sum(map(self.busy_s, plan.exchanges[:-1]))
        return before_s + self.request_s(plan.exchanges[-1]) + 0.5 * self._response_s

    def load(self, plans: Iterable[TaskPlan]) -> Load:
        """The line's load."""
        parts = [(plan.options.rate_hz, self.busy_s(exchange)) for plan in plans for exchange in plan.exchanges]
        kinds = dict.fromkeys(parts)
        detail = " + ".join(
            f"{parts.count(kind) * kind[0]:g} x {1e3 * kind[1]:.3g} ms (answers begun within "
            f"{self._options.response_ms:g} ms)"
            for kind in kinds
        )
        return Load(self._options.device, sum(rate_hz * busy_s for rate_hz, busy_s in parts), detail, _LIMIT)

    def refuse_short_timeout(self, plans: Iterable[TaskPlan]) -> None:
        """Raise ConfigError where answers that are in time would count as late."""
        for plan in plans:
            needed_ms = 1e3 * max(map(self.taken_s, plan.exchanges))
            if self._options.timeout_ms < needed_ms:
                raise ConfigError(
                    f"timeout_ms: {self._options.timeout_ms:g} ms is over before {plan.name} can be answered, which "
                    f"takes up to {needed_ms:.3g} ms"
                )

    def _wire_s(self, pdu_bytes: int) -> float:
        if serial := self._options.serial:
            return (pdu_bytes + RtuFraming.overhead_bytes) * serial.bits_per_byte / serial.baud
        assert self._options.tcp is not None
        bits = _ETHERNET_BITS + (pdu_bytes + TcpFraming.overhead_bytes) * 8
        return max(bits, _LEAST_ETHERNET_BITS) / (self._options.tcp.link_Mbit_per_s * 1e6)
