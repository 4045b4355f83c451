"""The driver ``udp``: a datagram out and one in, in every cycle, from compiled code; see docs/udp.md."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from micromanip.driver import Answer, Channel, ConfigError, Functions, Load
from micromanip.driver.wire import MOST_BITS, RECENT, LoopWire, hand_over

from .opening import Opening
from .options import UdpOptions
from .plan import Datagrams
from .records import BAD, CONTEXT

_LEAST_CYCLES = 3
"""The answer to a datagram may come in the next cycle, or the one after."""
_OVERHEAD_BYTES = 66
"""Ethernet with its gap, IP and UDP."""


class Udp(LoopWire):
    """A device that gets a datagram in every cycle of the loop and answers with one."""

    Options: ClassVar[type[BaseModel]] = UdpOptions
    CONTEXT, COUNTERS, BAD = CONTEXT, ("received", "strangers", *BAD), BAD
    options: UdpOptions

    def __init__(self, options: UdpOptions, period_ns: int) -> None:
        super().__init__(options, period_ns, options.send.fields, "send.fields")
        self._datagrams = Datagrams(options)
        if options.send.fields:
            options.send.must_last("send.", 1e9 / period_ns)
        self._counts = 1 << 8 * options.send.counter.size
        if options.send.fields and self._counts <= self.silent_cycles + RECENT:
            raise ConfigError(
                f"send.counter.type: {options.send.counter.type} begins anew after {self._counts} datagrams, "
                f"{self.silent_cycles} of which may go unanswered (silence_ms): take a longer type, or an old answer "
                "may count as a new one"
            )
        self._opening = Opening(options, self._datagrams, self.device)

    @property
    def device(self) -> str:
        return f"udp {self.options.host}:{self.options.port}"

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(self._datagrams.inputs)

    @property
    def slow_inputs(self) -> tuple[Channel, ...]:
        received, period_s = self.options.receive, self.period_ns * 1e-9
        age_s = self.age_s + received.latency_us * 1e-6
        channels = [Channel(name, 1 / period_s, age_s) for name in received.fields]
        for slow in received.slow.values():
            channels += [Channel(name, slow.rate_hz, age_s + slow.latency_us * 1e-6) for name in slow.fields]
        return tuple(channels)

    def loads(self) -> Sequence[Load]:
        """Both directions at the same time, as Ethernet is."""
        rate_hz, bits_per_s = 1e9 / self.period_ns, self.options.link_Mbit_per_s * 1e6
        loads = []
        for name, length in (("out", self._datagrams.sent_bytes), ("in", self._datagrams.received_bytes)):
            wire_s = 8 * (max(length, 18) + _OVERHEAD_BYTES) / bits_per_s
            loads.append(Load(name, rate_hz * wire_s, f"{rate_hz:g} x {1e6 * wire_s:.3g} us, {length} bytes"))
        return loads

    def fill(self, c: Any) -> None:
        c["receive"], c["send"] = self._datagrams.received, self._datagrams.sent
        c["gate"]["patient_cycles"] = max(_LEAST_CYCLES, round(1e6 * self.options.restart_ms / self.period_ns))
        c["counts"], c["counted"]["counts"] = self._counts, 1 << 8 * self.options.receive.counter.size
        if clock := self.options.receive.clock:
            c["clock"]["unit_ns"], c["clock"]["bits"] = clock.unit_us * 1e3, min(8 * clock.size, MOST_BITS)

    def begin(self, context: NDArray[np.uint8]) -> None:
        hand_over(self._opening.rest_then_ask(), self.record(context)["socket"])

    def functions(self) -> Functions:
        from . import exchange  # compiled: loaded only where it is going to be called

        return Functions(*exchange.ENTRIES.addresses)

    def probe(self, seconds: float) -> Iterator[Answer]:
        return self._opening.found(seconds)

    def is_at_rest(self) -> bool:
        return self._opening.confirms_rest()
