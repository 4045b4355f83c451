"""Faults of controllers: one that babbles, and those of the clients."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, PrivateAttr

from .fault import ClientFault, Disturbed, Fault
from .frame import Frame
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
