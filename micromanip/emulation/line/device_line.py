"""A line between a emulated device and whoever it talks to, with the faults that are injected into it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from micromanip.emulation.messages import MessageFigures
from micromanip.errors import UsageError
from micromanip.testbus.event_loop import EventLoop

from .faults import LineFault, LineFaults, MessageFault
from .port import Hear, LinePort, Peer, TcpPort, UdpPort
from .pseudo_terminal import PseudoTerminal


def _hear_nothing(data: bytes, peer: Peer) -> None:
    """Until a device is attached."""


class DeviceLine(Peer):
    """The device sends whole messages, to all or to one peer, and hears bytes as they come."""

    def __init__(self, loop: EventLoop, make_port: Callable[[Hear], LinePort], seed: int = 0) -> None:
        """`make_port` gets what hears for the port; `seed` is that of the injected faults."""
        self._loop = loop
        self._hear: Hear = _hear_nothing
        self._faults = LineFaults(loop, seed)
        self._latest_ns = {"sent": 0, "received": 0}
        self._strangers_message = b""
        self.port = make_port(self._arrived)

    def attach(self, hear: Hear) -> None:
        """Let the device hear."""
        self._hear = hear

    def send(self, data: bytes) -> None:
        """One message, to all that are connected."""
        self.answer(self.port, data)

    def answer(self, peer: Peer, message: bytes) -> None:
        """One message, to one peer."""
        if not self._faults.any:
            self._pass(peer.send, message, 0, "sent")
            return
        if self._faults.active("hang"):
            return
        if self._faults.active("stranger") and isinstance(self.port, UdpPort):
            self._strangers_message = self._strangers_message or message
            self.port.send_as_stranger(self._strangers_message)
        for after_ns, part in self._faults.through(message, "sent"):
            self._pass(peer.send, part, after_ns, "sent")

    @property
    def undisturbed(self) -> bool:
        """Whether no fault is active."""
        return not self._faults.any

    def active(self, kind: str) -> Any:
        """The fault of a kind that is active now, for a device that has to play it itself; None for none."""
        return self._faults.active(kind)

    def inject(self, fault: LineFault) -> None:
        """Let a fault begin now. Raises UsageError for one that this port can't have."""
        end: Callable[[], None] = lambda: None  # noqa: E731
        if isinstance(fault, MessageFault):
            fault = fault.model_copy(deep=True)  # it keeps what it holds back
            end = partial(self._let_go, fault)
        elif fault.kind == "unplug":
            self.port.unplug()
            end = self.port.plug_in
        elif fault.kind == "disconnect":
            if not isinstance(self.port, TcpPort):
                raise UsageError(f"fault disconnect: {self.port.name} has no connection")
            self.port.disconnect()
            return
        elif fault.kind == "echo":
            if not isinstance(self.port, PseudoTerminal):
                raise UsageError(f"fault echo: {self.port.name} is no serial line")
            end = partial(setattr, self.port, "echo", self.port.echo)
            self.port.echo = True
        elif fault.kind == "stranger":
            if not isinstance(self.port, UdpPort):
                raise UsageError(f"fault stranger: to {self.port.name} nobody else can send")
            self._strangers_message = b""
        self._faults.begin(fault, end)

    def clear(self) -> None:
        """End what was injected."""
        self._faults.clear()

    def close(self) -> None:
        """Let go of the port."""
        self.port.close()

    def _arrived(self, data: bytes, peer: Peer) -> None:
        if not self._faults.any or not data:
            self._pass(partial(self._heard, peer), data, 0, "received")
        elif not self._faults.active("hang"):
            for after_ns, part in self._faults.through(data, "received"):
                self._pass(partial(self._heard, peer), part, after_ns, "received")

    def _heard(self, peer: Peer, data: bytes) -> None:
        self._hear(data, peer)

    def _pass(self, to: Callable[[bytes], None], data: bytes, after_ns: int, direction: str) -> None:
        """At once if it can be; nothing overtakes what was delayed before."""
        now_ns = self._loop.now_ns()
        time_ns = max(now_ns + after_ns, self._latest_ns[direction])
        if time_ns <= now_ns:
            to(data)
        else:
            self._latest_ns[direction] = time_ns
            self._loop.call_at(time_ns, partial(to, data))

    def _let_go(self, fault: MessageFault) -> None:
        if held := fault.held():
            if fault.direction == "sent":
                self._pass(self.port.send, held, 0, "sent")
            else:
                self._pass(partial(self._heard, self.port), held, 0, "received")


def report_of(figures: MessageFigures, lines: Sequence[DeviceLine], elapsed_ns: int) -> dict[str, Any]:
    """Messages, bytes and load of a device on these lines, in so much time."""
    ports = [line.port.figures for line in lines]
    return {
        "frames": figures.sent + figures.received,
        **vars(figures),
        **{name: sum(getattr(port, name) for port in ports) for name in vars(ports[0])},
        "bus_load_percent": round(100 * ports[0].busy_ns / max(1, elapsed_ns), 2),
    }


def port_maker(keys: Any, loop: EventLoop, *, half_duplex: bool = False) -> Callable[[Hear], LinePort]:
    """What makes the device's end of the port that a driver's options name, in `serial`, `tcp` or `udp`.

    With `half_duplex` both directions of any serial line take turns, else those of RS-485.
    """
    if keys.serial is not None:
        return partial(_serial_port, keys.serial, loop, half_duplex)
    port = keys.tcp or keys.udp
    bits_per_s = 1e6 * port.link_Mbit_per_s
    if keys.tcp is not None:
        return lambda hear: TcpPort(loop, port.host, port.port, hear, bits_per_s)
    return lambda hear: UdpPort(loop, port.host, port.port, port.listen, hear, bits_per_s)


def _serial_port(keys: Any, loop: EventLoop, half_duplex: bool, hear: Hear) -> LinePort:
    port = PseudoTerminal(
        loop,
        Path(keys.device),
        keys.baud,
        lambda data: hear(data, port),
        bits_per_byte=keys.bits_per_byte,
        half_duplex=half_duplex or keys.rs485 is not None,
    )
    port.echo = keys.rs485 is not None and keys.rs485.echo
    return port
