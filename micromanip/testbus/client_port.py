"""A participant in another process, behind a socket that keeps packets apart (AF_UNIX, SOCK_SEQPACKET)."""

from __future__ import annotations

import json
import math
import socket
import struct
from collections.abc import Callable

from .event_loop import EventLoop
from .frame import FD, STAMP, Controller, Frame, controller_error, pack
from .port import Port, State, Transmission

_PACKET_BYTES = STAMP.size + FD.size
_LATE_NS = 200_000
_CREDENTIALS = struct.Struct("3i")  # struct ucred: process, user, group


def address(channel: str) -> str:
    """The abstract socket name at which the hub of `channel` listens."""
    return f"\0micromanip.can.{channel}"


class ClientPort(Port):
    """Takes a client's packets, and gives it those of the others.

    While its queue is full the hub leaves what it sends in the socket, whose buffer is small: soon the client's next
    send finds no room, as with SocketCAN. What it doesn't take itself is dropped and counted, and told by an error
    frame as soon as there is room.
    """

    def __init__(self, sock: socket.socket, loop: EventLoop, queue_frames: int) -> None:
        peer = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        self.process_id: int = _CREDENTIALS.unpack(peer)[0]
        super().__init__(f"process {self.process_id}", queue_frames)
        self.dropped = 0
        """Frames that it didn't take in time."""
        self._overflown = False
        self._sock = sock
        self._loop = loop
        self._listening = False
        sock.setblocking(False)

    def listen(
        self, on_packet: Callable[[ClientPort, int, bytes], None], on_gone: Callable[[ClientPort], None]
    ) -> None:
        """Call `on_packet` with what it sends (its time, ns, and the packed frame), `on_gone` when it is gone."""
        self._on_packet = on_packet
        self._on_gone = on_gone
        self.queue_changed()

    def greet(self, **about: int | None) -> None:
        """Tell the client about the bus: its first packet."""
        self._give(json.dumps(about).encode())

    def deliver(self, transmission: Transmission, time_ns: int) -> None:
        self._hand_over(transmission.packed, time_ns)

    def report(self, frame: Frame, time_ns: int) -> None:
        self._hand_over(pack(frame), time_ns)

    def queue_changed(self) -> None:
        """Listen while there is room in the queue; in bus-off too, to throw away what comes and to see it go."""
        listening = not self.leaving and (not self.full or self.state is State.BUS_OFF)
        if listening is self._listening:
            return
        self._listening = listening
        if listening:
            self._loop.add_reader(self._sock.fileno(), self._on_readable)
        else:
            self._loop.remove_reader(self._sock.fileno())

    def close(self) -> None:
        """End the connection; what is queued still goes out."""
        if not self.leaving:
            self.leaving = True
            self.queue_changed()
            self._sock.close()

    def _on_readable(self) -> None:
        """Take a packet; where the loop comes late all that waited, for the bus to give each its own time."""
        late_ns = self._loop.now_ns() - _LATE_NS
        while self._take_packet() < late_ns and self._listening:
            pass

    def _take_packet(self) -> float:
        """When what came was sent (CLOCK_MONOTONIC, ns)."""
        try:
            packet = self._sock.recv(_PACKET_BYTES)
        except BlockingIOError:
            return math.inf
        except OSError:
            packet = b""
        return self._take(packet)

    def _take(self, packet: bytes) -> float:
        time_ns = math.inf
        if not packet:
            self._gone()
        elif self.state is not State.BUS_OFF:
            try:
                time_ns = STAMP.unpack_from(packet)[0]
                self._on_packet(self, time_ns, packet[STAMP.size :])
            except (ValueError, struct.error):
                self._gone()  # it doesn't speak our language: better no peer than a wrong one
        return time_ns

    def _hand_over(self, packed: bytes, time_ns: int) -> None:
        stamp = STAMP.pack(time_ns)
        if self._overflown:
            told = self._give(stamp + pack(controller_error(Controller.RX_OVERFLOW)))
            self._overflown = not told
        if not self._give(stamp + packed):
            self.dropped += 1
            self._overflown = True

    def _give(self, packet: bytes) -> bool:
        if self.leaving:
            return True
        try:
            self._sock.send(packet)
        except BlockingIOError:
            return False
        except OSError:
            self._gone()
        return True

    def _gone(self) -> None:
        if not self.leaving:
            self.close()
            self._on_gone(self)
