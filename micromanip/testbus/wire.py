"""The wire of a bus: given to one frame at a time, to the lowest identifier that waits, for as long as the frame takes.

Bus time is CLOCK_MONOTONIC. The loop wakes a little late; what happened meanwhile is then worked off at the times at
which it would have happened, so the time stamps are those of a bus that is never late. A frame keeps the bus for its
worst-case bits and the intermission, and its stamp is the end of that. Every frame is acknowledged.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

from micromanip.bus import can_bits

from .event_loop import EventLoop, Timer
from .fault import Delivery, Verdict
from .faults import Faults
from .frame import Frame
from .port import Port, State, Transmission


@dataclass
class Statistics:
    """What went over the bus since it was started."""

    frames: int = 0
    """Those that arrived."""
    destroyed: int = 0
    """Those that an error frame ended."""
    busy_ns: int = 0
    """How long the bus was, and will be up to the end of the present frame, not idle."""


class Wire:
    """What the controllers share."""

    def __init__(self, loop: EventLoop, bitrate: int, data_bitrate: int | None, faults: Faults) -> None:
        self.statistics = Statistics()
        self.ports: list[Port] = []
        self._loop = loop
        self._bitrate = bitrate
        self._data_bitrate = data_bitrate
        self._faults = faults
        self._error_frame_ns = round(can_bits.error_frame_s(bitrate) * 1e9)
        self._duration_ns = lru_cache(maxsize=None)(self._worst_case_ns)
        self._on_air: tuple[Port, Transmission] | None = None
        self._end_ns = self._free_ns = loop.now_ns()
        self._timer: Timer | None = None
        self._advancing = False
        self._scheduled = 0
        self._handing_over_ns: int | None = None

    def join(self, port: Port) -> None:
        """Let a participant take part; what its queue holds is sent."""
        self.ports.append(port)
        self._wake()

    def leave(self, port: Port) -> None:
        """Take a participant off the bus; does no harm twice."""
        if port in self.ports:
            self.ports.remove(port)

    def transmission(self, frame: Frame, packed: bytes, arrival_ns: int) -> Transmission:
        """What a transmit queue needs to know of a frame. Raises ValueError for one that the bus can't carry."""
        if frame.fd and self._data_bitrate is None:
            raise ValueError("this bus carries classic frames only, not CAN FD")
        length = 0 if frame.remote else len(frame.data)
        duration_ns = self._duration_ns(length, frame.extended, frame.fd, frame.bitrate_switch)
        return Transmission(frame, packed, frame.priority, duration_ns, arrival_ns)

    def enqueue(self, port: Port, transmission: Transmission) -> None:
        """Put a frame into a participant's transmit queue."""
        port.queue.append(transmission)
        port.queue_changed()
        self._wake()

    def now_ns(self) -> int:
        """The time of the bus: while a frame is handed over that of the frame, which may have waited for the loop."""
        return self._loop.now_ns() if self._handing_over_ns is None else self._handing_over_ns

    def hand_over(self, delivery: Delivery) -> None:
        """Give a frame to all but its sender."""
        before_ns, self._handing_over_ns = self._handing_over_ns, delivery.time_ns
        for port in list(self.ports):
            if port is not delivery.sender and not port.leaving and port.state is not State.BUS_OFF:
                port.received(delivery.stamp_ns)
                port.deliver(delivery.transmission, delivery.stamp_ns)
        self._handing_over_ns = before_ns

    def close(self) -> None:
        """Be still."""
        if self._timer is not None:
            self._timer.cancel()
        self.ports.clear()

    def _worst_case_ns(self, length: int, extended: bool, fd: bool, bitrate_switch: bool) -> int:
        data_bitrate = (self._data_bitrate if bitrate_switch else self._bitrate) if fd else None
        return round(can_bits.worst_case_s(length, self._bitrate, data_bitrate, extended) * 1e9)

    def _wake(self) -> None:
        """Something may be waiting."""
        if self._on_air is None and not self._advancing:
            self._advance()

    def _advance(self) -> None:
        """Bring the bus up to now."""
        self._advancing = True
        now_ns = self._loop.now_ns()
        while self._on_air is not None or self._start():
            if self._end_ns > now_ns:
                self._timer = self._loop.call_at(self._end_ns, self._advance)
                break
            self._finish()
        self._advancing = False

    def _start(self) -> bool:
        """Give the bus to the frame that wins the arbitration; False if none waits."""
        waiting = [port for port in self.ports if port.queue]
        if not waiting:
            return False
        start_ns = max(self._free_ns, min(port.queue[0].arrival_ns for port in waiting))
        winner = min(
            (port for port in waiting if port.queue[0].arrival_ns <= start_ns), key=lambda port: port.queue[0].priority
        )
        transmission = winner.queue.popleft()
        winner.queue_changed()
        self._on_air = winner, transmission
        self._end_ns = start_ns + transmission.duration_ns
        self.statistics.busy_ns += transmission.duration_ns
        return True

    def _finish(self) -> None:
        """End the frame that is on the air."""
        assert self._on_air is not None
        sender, transmission = self._on_air
        self._on_air = None
        self._free_ns = self._end_ns
        if sender.state is State.BUS_OFF:
            return  # it fell silent in the middle
        verdict = self._faults.verdict(transmission)
        if verdict is Verdict.DESTROYED:
            self._destroy(sender, transmission)
            return
        self.statistics.frames += 1
        sender.sent(self._end_ns)
        if verdict is Verdict.REPEATED and not transmission.repeated:
            sender.queue.appendleft(transmission._replace(repeated=True))
        if sender.leaving and not sender.queue:
            self.leave(sender)
        for delivery in self._faults.through(Delivery(self._end_ns, self._end_ns, sender, transmission)):
            if self._scheduled or delivery.time_ns > self._loop.now_ns():
                self._scheduled += 1
                self._loop.call_at(delivery.time_ns, partial(self._hand_over_scheduled, delivery))
            else:
                self.hand_over(delivery)

    def _hand_over_scheduled(self, delivery: Delivery) -> None:
        self._scheduled -= 1
        self.hand_over(delivery)

    def _destroy(self, sender: Port, transmission: Transmission) -> None:
        """An error frame ends a frame that is on the air; its sender will try again unless it goes bus-off."""
        self._free_ns += self._error_frame_ns
        self.statistics.busy_ns += self._error_frame_ns
        self.statistics.destroyed += 1
        sender.queue.appendleft(transmission)
        for port in list(self.ports):
            if port.state is not State.BUS_OFF:
                port.failed(port is sender, self._free_ns)
        if sender.state is State.BUS_OFF:
            if sender.leaving:
                self.leave(sender)
            elif sender.restart_ns is not None:
                self._loop.call_at(self._free_ns + sender.restart_ns, partial(self._restart, sender))

    def _restart(self, port: Port) -> None:
        if port in self.ports and port.state is State.BUS_OFF:
            port.restart(self._loop.now_ns())
