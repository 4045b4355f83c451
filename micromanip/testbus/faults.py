"""Faults of a simulated bus and its controllers: injected while it runs, each for a time, alike for the same seed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from random import Random
from typing import Annotated, Literal

from pydantic import Field, PrivateAttr, TypeAdapter

from micromanip.errors import UsageError

from .event_loop import EventLoop, Timer
from .fault import ClientFault, Delivery, Disturbed, Fault, FrameFault, Verdict, validated
from .frame import Frame
from .frame_faults import Burst, Corrupt, Delay, Drop, Duplicate, Reorder, Silence
from .port import LEAST_PASSIVE, Port, State, Transmission


class _BabblingPort(Port):
    """Has always one more frame to send."""

    def __init__(self, transmission: Transmission) -> None:
        super().__init__("babbling node", queue_frames=1)
        self._transmission = transmission
        self.queue_changed()

    def deliver(self, transmission: Transmission, time_ns: int) -> None:
        pass  # it doesn't listen

    def queue_changed(self) -> None:
        if not self.queue:
            self.queue.append(self._transmission)


class Babble(Fault):
    """A node sends frames of one identifier back to back, and lets in only what has a lower one."""

    kind: Literal["babble"] = "babble"
    identifier: int = Field(default=0, ge=0, le=0x7FF)
    _port: Port | None = PrivateAttr(default=None)

    def begin(self, bus: Disturbed) -> None:
        self._port = _BabblingPort(bus.transmission(Frame(self.identifier, bytes(8))))
        bus.join(self._port)

    def end(self, bus: Disturbed) -> None:
        if self._port is not None:
            bus.leave(self._port)


class BusOff(ClientFault):
    """The client's controller is bus-off: it hears nothing and sends nothing until it connects again, or this ends."""

    kind: Literal["bus_off"] = "bus_off"

    def begin(self, bus: Disturbed) -> None:
        for port in list(self.struck(bus)):
            port.go_bus_off(bus.now_ns())

    def end(self, bus: Disturbed) -> None:
        for port in list(self.struck(bus)):
            if port.state is State.BUS_OFF:
                port.restart(bus.now_ns())


class ErrorPassive(ClientFault):
    """The client's controller counts so many errors that it is error-passive; it recovers as it sends."""

    kind: Literal["error_passive"] = "error_passive"

    def begin(self, bus: Disturbed) -> None:
        for port in list(self.struck(bus)):
            port.keep_transmit_errors(LEAST_PASSIVE, bus.now_ns())

    def end(self, bus: Disturbed) -> None:
        for port in list(self.struck(bus)):
            port.keep_transmit_errors(0, bus.now_ns())


class Enobufs(ClientFault):
    """The client's transmit queue takes nothing more: its buffers fill, and its sends fail."""

    kind: Literal["enobufs"] = "enobufs"

    def begin(self, bus: Disturbed) -> None:
        for port in self.struck(bus):
            port.refuse(True)

    def end(self, bus: Disturbed) -> None:
        for port in self.struck(bus):
            port.refuse(False)


__all__ = [
    *("Babble", "Burst", "BusOff", "Corrupt", "Delay", "Drop", "Duplicate", "Enobufs", "ErrorPassive", "Faults"),
    *("Reorder", "Silence", "parsed"),
]

_ANY: TypeAdapter[Fault] = TypeAdapter(
    Annotated[
        Drop | Silence | Delay | Reorder | Burst | Corrupt | Duplicate | Babble | BusOff | ErrorPassive | Enobufs,
        Field(discriminator="kind"),
    ]
)


def parsed(document: object) -> Fault:
    """The fault that a mapping describes, e.g. ``{"kind": "drop", "share": 0.1, "for_s": 2.0, "identifier": 257}``.

    Raises UsageError with the first thing that is wrong with it.
    """
    return validated(_ANY, document)


class Faults:
    """Those that are active on one bus."""

    def __init__(self, bus: Disturbed, channel: str, loop: EventLoop, seed: int) -> None:
        self._bus, self._channel = bus, channel
        self._loop = loop
        self._random = Random(seed)
        self._active: list[tuple[Fault, Timer | None]] = []
        self._striking: list[FrameFault] = []
        self._latest_ns = 0

    def inject(self, fault: Fault) -> None:
        """Let `fault` begin now; it ends by itself after its ``for_s``.

        Raises UsageError for a fault of a client if that isn't connected.
        """
        fault = fault.model_copy(deep=True)  # what it has taken hold of is kept in it
        if isinstance(fault, ClientFault) and not any(fault.struck(self._bus)):
            who = "no client is" if fault.client is None else f"process {fault.client} is not"
            raise UsageError(f"fault {fault.kind}: {who} connected to channel {self._channel}")
        if isinstance(fault, FrameFault):
            fault.draw_from(self._random)
        fault.begin(self._bus)
        timer = None
        if fault.for_s is not None:
            timer = self._loop.call_at(self._loop.now_ns() + round(fault.for_s * 1e9), partial(self._end, fault))
        self._active.append((fault, timer))
        self._note_striking()

    def clear(self) -> None:
        """End all of them."""
        for fault, timer in list(self._active):
            if timer is not None:
                timer.cancel()
            self._end(fault)

    def verdict(self, transmission: Transmission) -> Verdict:
        """What becomes of a frame at its end: the first fault that strikes it decides."""
        for fault in self._striking:
            if fault.strikes(transmission):
                verdict = fault.verdict()
                if verdict is not Verdict.GOOD:
                    return verdict
        return Verdict.GOOD

    def through(self, delivery: Delivery) -> Sequence[Delivery]:
        """What the receivers get in place of `delivery`: passed through one fault after the other, then in order."""
        if not self._striking and delivery.time_ns >= self._latest_ns:
            return (delivery,)
        deliveries = [delivery]
        for fault in self._striking:
            if fault.strikes(delivery.transmission):
                deliveries = [passed for each in deliveries for passed in fault.through(each)]
        return [self._in_order(each) for each in deliveries]

    def _in_order(self, delivery: Delivery) -> Delivery:
        """Nothing overtakes what was delayed, also when the delay is over."""
        self._latest_ns = max(self._latest_ns, delivery.time_ns)
        return delivery if delivery.time_ns == self._latest_ns else delivery.put_off(self._latest_ns)

    def _end(self, fault: Fault) -> None:
        self._active = [(other, timer) for other, timer in self._active if other is not fault]
        self._note_striking()
        fault.end(self._bus)

    def _note_striking(self) -> None:
        self._striking = [fault for fault, _ in self._active if isinstance(fault, FrameFault)]
