"""The driver ``udp``: a datagram out and one in, in every cycle, from compiled code; see docs/udp.md."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from socket import socket
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from micromanip.driver import Answer, Channel, ConfigError, Functions, IdentityMismatch, LinkError, Load
from micromanip.driver.wire import MOST_BITS, RECENT, LoopWire, hand_over, open_datagrams

from .options import UdpOptions
from .plan import Datagrams
from .records import BAD, CONTEXT

_ANSWER_S, _LONGEST_S = 0.02, 1.0
_LARGEST = 2048


class Opening:
    """Talks to the device while the loop doesn't."""

    def __init__(self, options: UdpOptions, datagrams: Datagrams, name: str) -> None:
        self._options, self._datagrams, self._name = options, datagrams, name
        self._safe = [field.safe for field in options.send.fields.values()]

    def connected(self) -> socket:
        """A socket to the device. Raises LinkError."""
        options = self._options
        return open_datagrams(options.host, options.port, options.listen, _ANSWER_S)

    def rest_then_ask(self) -> socket:
        """A socket to the right device, at rest. Raises LinkError, IdentityMismatch.

        Nobody else sends to it: who opens it has its lock. So nothing is sent for as long as its watchdog takes.
        """
        if self._options.watchdog is not None:
            time.sleep(self._options.watchdog.still_ns * 1e-9)
        opened = self.connected()
        try:
            if self._options.identity is not None:
                self._ask_who(opened)
        except BaseException:
            opened.close()
            raise
        return opened

    def confirms_rest(self) -> bool:
        """Send the safe values, to a device that is at rest, until it answers; whether it does."""
        with self.connected() as opened:
            for count, data in enumerate(self._exchanged(opened, _LONGEST_S)):
                if count >= 2 and self._datagrams.is_answer(data):
                    return True
        return False

    def found(self, seconds: float) -> Iterator[Answer]:
        """What it says of itself, as long as it may be asked; it is not sent any output.

        Raises LinkError.
        """
        end, note = time.monotonic() + seconds, ""
        with self.connected() as opened:
            while time.monotonic() < end:
                if self._options.identity is not None:
                    _send(opened, self._datagrams.request)
                elif not self._safe:
                    _send(opened, self._datagrams.frame([], 0))
                data = _receive(opened)
                if data is None:
                    continue
                if self._datagrams.says_who(data):
                    note = "; ".join(self._datagrams.mismatches(data))
                    yield Answer(f"{self._name} identity", self._datagrams.identity(data), note)
                elif self._datagrams.is_answer(data):
                    status = self._datagrams.status(data)
                    note = f"status {status}" if status else ""
                    yield Answer(f"{self._name} receive", self._datagrams.values(data), note)
                else:
                    note = f"{len(data)} bytes, not as configured"
                    yield Answer(f"{self._name} other", {"bytes": data.hex(" ")}, note, is_value=False)

    def _ask_who(self, opened: socket) -> None:
        end, other = time.monotonic() + _LONGEST_S, 0
        while time.monotonic() < end:
            _send(opened, self._datagrams.request)
            data = _receive(opened)
            if data is None:
                continue
            if self._datagrams.says_who(data):
                if differences := self._datagrams.mismatches(data):
                    raise IdentityMismatch(f"{self._name} has {' and '.join(differences)}")
                return
            other += 1
        why = f"{other} datagrams came that are not the answer" if other else "nothing answers"
        raise LinkError(f"{self._name} does not say who it is: {why}; check power, cable, host, port and `identity`")

    def _exchanged(self, opened: socket, seconds: float) -> Iterator[bytes]:
        end, count = time.monotonic() + seconds, 0
        while time.monotonic() < end:
            _send(opened, self._datagrams.frame(self._safe, count % 256))
            data = _receive(opened)
            if data is not None:
                count += 1
                yield data


def _send(opened: socket, data: bytes) -> None:
    try:
        opened.send(data)
    except OSError:  # nobody listened to the one before, or the network is down: nothing will answer
        time.sleep(_ANSWER_S)


def _receive(opened: socket) -> bytes | None:
    try:
        return opened.recv(_LARGEST)
    except OSError:
        return None


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
