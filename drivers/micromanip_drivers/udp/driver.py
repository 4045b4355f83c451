"""The driver ``udp``: a datagram out and one in, in every cycle, from compiled code; see docs/udp.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from micromanip.driver import Answer, Channel, ConfigError, CyclicDriver, Functions, Load, SafeOutput, Wire
from micromanip.driver.wire import (
    MAX_OUTPUTS,
    MOST_BITS,
    RECENT,
    adopt_limits,
    close_gate,
    gate_statistics,
    hand_over,
    wait_for_rest,
    wire_of,
)

from .opening import Opening
from .options import UdpOptions
from .plan import Datagrams
from .records import CONTEXT, COUNTERS

_OVERHEAD_BYTES = 66
"""Ethernet with its gap, IP and UDP."""
_UNSAFE = 1


class Udp(CyclicDriver):
    """A device that gets a datagram in every cycle of the loop and answers with one."""

    Options: ClassVar[type[BaseModel]] = UdpOptions

    def __init__(self, options: UdpOptions, period_ns: int) -> None:
        self.options, self.period_ns = options, period_ns
        self.simulated = options.simulated  # type: ignore[misc]
        self.watchdog = None if options.watchdog is None else options.watchdog.does  # type: ignore[misc]
        self._datagrams = Datagrams(options)
        if options.send.fields and not options.send.cyclic_safe:
            raise ConfigError(
                f"send.cyclic_safe: {1e9 / period_ns:g} writes a second wear out a device that keeps them in flash "
                "memory; say cyclic_safe: true if its manual allows them for ever"
            )
        if len(options.send.fields) > MAX_OUTPUTS:
            raise ConfigError(f"send.fields: {len(options.send.fields)} outputs, at most {MAX_OUTPUTS} are possible")
        self._counts = 1 << 8 * options.send.counter.size
        self._silent_cycles = math.ceil(options.silence_ms * 1e6 / period_ns)
        if options.send.fields and self._counts <= self._silent_cycles + RECENT:
            raise ConfigError(
                f"send.counter.type: {options.send.counter.type} begins anew after {self._counts} datagrams, "
                f"{self._silent_cycles} of which may go unanswered (silence_ms): take a longer type, or an old answer "
                "may count as a new one"
            )
        self._opening = Opening(options, self._datagrams, self.device)
        self._tables = self._datagrams.received_plan.record(), self._datagrams.sent_plan.record()

    @property
    def virtual(self) -> bool:
        return False

    @property
    def device(self) -> str:
        return f"udp {self.options.host}:{self.options.port}"

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(self._datagrams.inputs)

    @property
    def outputs(self) -> tuple[str, ...]:
        return tuple(self.options.send.fields)

    @property
    def slow_inputs(self) -> tuple[Channel, ...]:
        """The answer to what was sent in one cycle is taken in the next."""
        received, period_s = self.options.receive, self.period_ns * 1e-9
        age_s = period_s + received.latency_us * 1e-6
        channels = [Channel(name, 1 / period_s, age_s) for name in received.fields]
        for slow in received.slow.values():
            channels += [Channel(name, slow.rate_hz, age_s + slow.latency_us * 1e-6) for name in slow.fields]
        return tuple(channels)

    @property
    def slow_outputs(self) -> tuple[Channel, ...]:
        fields = self.options.send.fields.items()
        return tuple(Channel(name, 1e9 / self.period_ns, 0.0, field.safe) for name, field in fields)

    def loads(self) -> Sequence[Load]:
        """Both directions at the same time, as Ethernet is."""
        rate_hz, bits_per_s = 1e9 / self.period_ns, self.options.link_Mbit_per_s * 1e6
        loads = []
        for name, length in (("out", self._datagrams.sent_bytes), ("in", self._datagrams.received_bytes)):
            wire_s = 8 * (max(length, 18) + _OVERHEAD_BYTES) / bits_per_s
            loads.append(Load(name, rate_hz * wire_s, f"{rate_hz:g} x {1e6 * wire_s:.3g} us, {length} bytes"))
        return loads

    def context(self) -> NDArray[np.uint8]:
        context = np.zeros(1, CONTEXT)
        c, options = context[0], self.options
        c["receive"], c["send"] = self._tables[0][0], self._tables[1][0]
        c["socket"]["descriptor"] = -1
        watchdog, fields = options.watchdog, options.send.fields.values()
        close_gate(
            c["gate"],
            [(field.safe, field.switch) for field in fields],
            self._silent_cycles,
            (watchdog.ms, watchdog.rest_ms) if watchdog else None,
        )
        c["counts"] = self._counts
        c["counted"]["counts"] = 1 << 8 * options.receive.counter.size
        if clock := options.receive.clock:
            c["clock"]["unit_ns"], c["clock"]["bits"] = clock.unit_us * 1e3, min(8 * clock.size, MOST_BITS)
        return context.view(np.uint8)

    def adopt(self, context: NDArray[np.uint8], outputs: Sequence[SafeOutput]) -> None:
        adopt_limits(context.view(CONTEXT)[0]["gate"], outputs, self.period_ns)

    def begin(self, context: NDArray[np.uint8]) -> None:
        hand_over(self._opening.rest_then_ask(), context.view(CONTEXT)[0]["socket"])

    def functions(self) -> Functions:
        from . import exchange  # compiled: loaded only where it is going to be called

        return Functions(
            exchange.open_c.address, exchange.exchange_c.address, exchange.safe_c.address, exchange.close_c.address
        )

    def safe_in_host(self) -> Callable[[NDArray[np.uint8]], int]:
        return self._made_safe

    def statistics(self, context: NDArray[np.uint8]) -> Mapping[str, int]:
        c = context.view(CONTEXT)[0]
        counted = {name: int(c["counted"][name]) for name in ("lost", "doubled", "late", "restarts")}
        counts = {name: int(c[name]) for name in COUNTERS} | gate_statistics(c["gate"])
        bad = sum(counts[name] for name in ("wrong_length", "wrong_checksum", "not_this_datagram", "not_sent"))
        totals = {"performed": int(c["gate"]["sent_count"]), "errors": bad}
        return {**counts, **counted, "clock_steps": int(c["clock"]["steps"]), **totals}

    def wire(self, context: NDArray[np.uint8]) -> Wire:
        return wire_of(context.view(CONTEXT)[0]["gate"])

    def probe(self, seconds: float) -> Iterator[Answer]:
        return self._opening.found(seconds)

    def _made_safe(self, context: NDArray[np.uint8]) -> int:
        """Its watchdog has brought it to rest by then; whether it is there, and takes that."""
        wait_for_rest(context.view(CONTEXT)[0]["gate"])
        return 0 if self._opening.confirms_rest() else _UNSAFE
