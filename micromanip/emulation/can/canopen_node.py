"""A CANopen device for tests: sensor, amplifier, or whatever its EDS file describes.

It boots, obeys NMT, sends heartbeats, answers SDO, sends its TPDOs at SYNC or by their event timer, takes
RPDOs, and watches who commands it: by the event timer of an RPDO and by the consumer heartbeat time. Its measured
values come from a callable and its outputs go to one, by the objects' names in the EDS and in the units of their
`Factor`. Like many a real device it keeps its outputs when it is told to go to PRE-OPERATIONAL, and makes them safe
when it is stopped, reset, or left alone: at the error value of CiA 401 (object 6444) where it has one, or 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from micromanip.emulation.amplifier import Watchdog
from micromanip.testbus.event_loop import EventLoop, Timer
from micromanip.testbus.frame import Frame
from micromanip.testbus.hub import CanHub

from .can_bus import PythonCanBus
from .canopen_exchange import Exchange, TooShort
from .canopen_objects import Objects

INITIALISING, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
"""States of NMT."""
PDO_TOO_SHORT, NO_OUTPUTS, NO_HEARTBEAT = 0x8210, 0x8250, 0x8130
"""Emergency codes."""

_NMT, _SYNC, _EMERGENCY, _SDO_ANSWER, _SDO_REQUEST, _HEARTBEAT = 0x000, 0x080, 0x080, 0x580, 0x600, 0x700
_START, _STOP, _ENTER_PRE_OPERATIONAL, _RESET_NODE, _RESET_COMMUNICATION = 1, 2, 128, 129, 130
_GENERIC_ERROR, _COMMUNICATION_ERROR = 0x01, 0x11
"""Bits of the error register; an error of any kind sets the generic one too."""
_DOWNLOAD = 1
"""Command specifier of an SDO client that writes."""
_MS = 1_000_000


class CanOpenNode:
    """A device with number `node_id` on a bus, which boots at once."""

    def __init__(
        self,
        bus: CanHub | PythonCanBus,
        loop: EventLoop,
        eds: Path,
        node_id: int,
        measure: Callable[[Iterable[str]], Iterable[float]],
        write: Callable[[Mapping[str, float]], None],
    ) -> None:
        """`measure` gives the values of measured objects by their names, `write` takes those of outputs."""
        self.node_id = node_id
        self.state = INITIALISING
        self.objects = Objects(eds, node_id, lambda data: self._send(_SDO_ANSWER, data))
        self._bus, self._loop = bus, loop
        self._exchange = Exchange(
            loop,
            self.objects,
            measure,
            write,
            lambda frame: bus.send(self, frame),
            lambda: self._left_alone(NO_OUTPUTS),
        )
        self._errors = 0
        self._beat_timer: Timer | None = None
        self._commander = Watchdog(loop, lambda: self._left_alone(NO_HEARTBEAT))
        self._expects = -1
        self._silence_ns = 0
        bus.attach(self)
        self._boot()

    def reboot(self) -> None:
        """As if it had been without power for a moment."""
        self._exchange.make_safe()
        self.objects.forget()
        self._boot()

    def emergency(self, code: int, register: int = 0x81) -> None:
        """Report an error of the device."""
        self._errors |= register
        self.objects.put(0x1001, 0, self._errors)
        self.objects.remember_error(code)
        self._send_emergency(code, self._errors)

    def clear_emergency(self) -> None:
        """Report that all is well again."""
        self._clear(0xFF)

    def detach(self) -> None:
        """Leave the bus: its power is off."""
        self._exchange.stop()
        self._exchange.make_safe()
        self._cancel()
        self._bus.detach(self)

    def on_frame(self, frame: Frame, time_ns: int) -> None:
        """What the bus calls for each frame of the others."""
        if frame.extended or frame.remote or frame.error:
            return
        identifier, data = frame.identifier, frame.data
        if identifier == _SYNC:
            self._exchange.on_sync()
        elif identifier == _NMT and len(data) >= 2 and data[1] in (0, self.node_id):
            self._command(data[0])
        elif identifier == _SDO_REQUEST + self.node_id and len(data) == 8 and self.state != STOPPED:
            self._on_request(data)
        elif identifier == self._expects:
            self._commander.feed(time_ns, self._silence_ns)
        else:
            try:
                self._exchange.on_frame(identifier, data, time_ns)
            except TooShort:
                self.emergency(PDO_TOO_SHORT, _COMMUNICATION_ERROR)

    def _boot(self) -> None:
        self._cancel()
        self._errors = self.objects.raw(0x1001)
        self._enter(INITIALISING)
        self._send(_HEARTBEAT, b"\0")
        self._exchange.set_up()
        self._set_consumer()
        self._enter(PRE_OPERATIONAL)
        self._set_heartbeat()

    def _cancel(self) -> None:
        self._commander.stop()
        if self._beat_timer is not None:
            self._beat_timer.cancel()
        self._beat_timer = None

    def _enter(self, state: int) -> None:
        before, self.state = self.state, state
        if state == OPERATIONAL and before != OPERATIONAL:
            self._exchange.start()
        elif state != OPERATIONAL:
            self._exchange.stop()

    def _command(self, command: int) -> None:
        if command == _START:
            self._enter(OPERATIONAL)
            self._clear(_COMMUNICATION_ERROR)
        elif command == _STOP:
            self._enter(STOPPED)
            self._exchange.make_safe()
        elif command == _ENTER_PRE_OPERATIONAL:
            self._enter(PRE_OPERATIONAL)
        elif command == _RESET_NODE:
            self.reboot()
        elif command == _RESET_COMMUNICATION:
            self.objects.forget(0x1000, 0x2000)
            self._boot()

    def _left_alone(self, code: int) -> None:
        """Nobody commands it: safe at once, and to PRE-OPERATIONAL unless object 1029 says otherwise."""
        self._exchange.make_safe()
        self.emergency(code, _COMMUNICATION_ERROR)
        if self.state == OPERATIONAL and not (self.objects.has(0x1029, 1) and self.objects.raw(0x1029, 1)):
            self._enter(PRE_OPERATIONAL)

    def _on_request(self, request: bytes) -> None:
        self.objects.serve(request)
        index = int.from_bytes(request[1:3], "little")
        if request[0] >> 5 != _DOWNLOAD:
            return
        if index == 0x1017:
            self._set_heartbeat()
        elif index == 0x1016:
            self._set_consumer()
        elif 0x1400 <= index < 0x1C00:
            self._exchange.set_up()

    def _set_heartbeat(self) -> None:
        """Send the heartbeat by the producer heartbeat time from now on."""
        if self._beat_timer is not None:
            self._beat_timer.cancel()
            self._beat_timer = None
        if self.objects.raw(0x1017):
            self._beat(self._loop.now_ns())

    def _beat(self, due_ns: int) -> None:
        self._send(_HEARTBEAT, bytes((self.state,)))
        next_ns = due_ns + self.objects.raw(0x1017) * _MS
        self._beat_timer = self._loop.call_at(next_ns, lambda: self._beat(next_ns))

    def _set_consumer(self) -> None:
        """Watch the heartbeat that the consumer heartbeat time names, from its first one on."""
        word = self.objects.raw(0x1016, 1) if self.objects.has(0x1016, 1) else 0
        watched, self._silence_ns = word >> 16 & 0x7F, (word & 0xFFFF) * _MS
        self._expects = _HEARTBEAT + watched if watched and self._silence_ns else -1

    def _clear(self, errors: int) -> None:
        """Take bits of the error register back; the generic one stays as long as any other."""
        left = self._errors & ~errors & ~_GENERIC_ERROR
        if self._errors:
            self._errors = left | _GENERIC_ERROR if left else 0
            self.objects.put(0x1001, 0, self._errors)
            self._send_emergency(0, self._errors)

    def _send_emergency(self, code: int, register: int) -> None:
        if self.state != STOPPED:
            self._send(_EMERGENCY, code.to_bytes(2, "little") + bytes((register, 0, 0, 0, 0, 0)))

    def _send(self, service: int, data: bytes) -> None:
        self._bus.send(self, Frame(service + self.node_id, data))
