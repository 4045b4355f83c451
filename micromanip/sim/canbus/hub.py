"""The bus: gives it to one frame at a time, to the lowest identifier that waits, for as long as the frame takes.

Bus time is CLOCK_MONOTONIC. The loop wakes a little late; what happened meanwhile is then worked off at the times at
which it would have happened, so the time stamps are those of a bus that is never late. A frame keeps the bus for its
worst-case bits and the intermission, and its stamp is the end of that. The hub acknowledges every frame itself.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

from micromanip.errors import DeviceUnavailable
from micromanip.io import can_bits
from micromanip.sim.event_loop import EventLoop, Timer

from .client_port import ClientPort, address
from .frame import Frame, pack, unpack
from .port import Node, NodePort, Port, State, Transmission

QUEUE_FRAMES = 10
"""Frames that a participant can have waiting: the queue length of SocketCAN devices."""
_BACKLOG = 16


@dataclass
class Statistics:
    """What went over the bus since it was started."""

    frames: int = 0
    destroyed: int = 0
    busy_ns: int = 0
    began_ns: int = 0


class CanHub:
    """A CAN bus: nodes of this process are attached, those of others connect by ``client.HubBus``."""

    def __init__(
        self,
        loop: EventLoop,
        channel: str,
        bitrate: int,
        data_bitrate: int | None = None,
        *,
        queue_frames: int = QUEUE_FRAMES,
    ) -> None:
        """A bus at `bitrate`, with `data_bitrate` one for CAN FD.

        Raises DeviceUnavailable if `channel` has a hub already.
        """
        self.channel = channel
        self.bitrate = bitrate
        self.data_bitrate = data_bitrate
        self.statistics = Statistics(began_ns=loop.now_ns())
        self._loop = loop
        self._queue_frames = queue_frames
        self._ports: list[Port] = []
        self._nodes: dict[int, NodePort] = {}
        self._on_air: tuple[Port, Transmission] | None = None
        self._end_ns = self._free_ns = loop.now_ns()
        self._timer: Timer | None = None
        self._advancing = False
        self._duration_ns = lru_cache(maxsize=None)(self._worst_case_ns)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._listener.bind(address(channel))
        except OSError as error:
            self._listener.close()
            raise DeviceUnavailable(
                f"channel {channel} is simulated by another process already; stop it, or choose another channel"
            ) from error
        self._listener.listen(_BACKLOG)
        self._listener.setblocking(False)
        loop.add_reader(self._listener.fileno(), self._accept)

    @property
    def clients(self) -> Iterator[ClientPort]:
        """Those that are connected from other processes."""
        return (port for port in self._ports if isinstance(port, ClientPort) and not port.leaving)

    def attach(self, node: Node) -> None:
        """Let a node of this process take part: its ``on_frame`` gets what the others send."""
        port = self._nodes[id(node)] = NodePort(node, self._queue_frames)
        self._ports.append(port)

    def detach(self, node: Node) -> None:
        """Take a node off the bus, with what it has queued: it was switched off."""
        self._ports.remove(self._nodes.pop(id(node)))

    def send(self, node: Node, frame: Frame) -> bool:
        """Queue a frame of an attached node; False if its queue is full or it is bus-off, and the frame lost.

        Raises ValueError for a frame that the bus can't carry.
        """
        port = self._nodes[id(node)]
        if port.full or port.state is State.BUS_OFF:
            return False
        self._enqueue(port, frame, pack(frame), self._loop.now_ns())
        return True

    def state(self, node: Node) -> State:
        """Error state of an attached node's controller."""
        return self._nodes[id(node)].state

    def close(self) -> None:
        """End the bus: clients find their connection closed."""
        if self._timer is not None:
            self._timer.cancel()
        self._loop.remove_reader(self._listener.fileno())
        self._listener.close()
        for client in list(self.clients):
            client.close()
        self._ports.clear()

    def _accept(self) -> None:
        try:
            sock = self._listener.accept()[0]
        except OSError:
            return  # it changed its mind
        client = ClientPort(sock, self._loop, self._queue_frames, self._on_packet, self._on_gone)
        self._ports.append(client)
        client.greet(bitrate=self.bitrate, data_bitrate=self.data_bitrate)

    def _on_packet(self, client: ClientPort, time_ns: int, packed: bytes) -> None:
        self._enqueue(client, unpack(packed), packed, min(time_ns, self._loop.now_ns()))

    def _on_gone(self, client: ClientPort) -> None:
        if not client.queue:
            self._ports.remove(client)

    def _worst_case_ns(self, length: int, extended: bool, fd: bool, bitrate_switch: bool) -> int:
        data_bitrate = (self.data_bitrate if bitrate_switch else self.bitrate) if fd else None
        return round(can_bits.worst_case_s(length, self.bitrate, data_bitrate, extended) * 1e9)

    def _enqueue(self, port: Port, frame: Frame, packed: bytes, arrival_ns: int) -> None:
        if frame.fd and self.data_bitrate is None:
            raise ValueError(f"channel {self.channel} carries classic frames only, not CAN FD")
        port.queue.append(Transmission(frame, packed, arrival_ns, frame.priority))
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
        waiting = [port for port in self._ports if port.queue]
        if not waiting:
            return False
        start_ns = max(self._free_ns, min(port.queue[0].arrival_ns for port in waiting))
        winner = min(
            (port for port in waiting if port.queue[0].arrival_ns <= start_ns), key=lambda port: port.queue[0].priority
        )
        transmission = winner.queue.popleft()
        winner.taken()
        frame = transmission.frame
        duration_ns = self._duration_ns(
            0 if frame.remote else len(frame.data), frame.extended, frame.fd, frame.bitrate_switch
        )
        self._on_air = winner, transmission
        self._end_ns = start_ns + duration_ns
        self.statistics.busy_ns += duration_ns
        return True

    def _finish(self) -> None:
        """End the frame that is on the air."""
        assert self._on_air is not None
        sender, transmission = self._on_air
        self._on_air = None
        self._free_ns = self._end_ns
        if sender.state is State.BUS_OFF:
            return  # it fell silent in the middle
        self.statistics.frames += 1
        sender.sent(self._end_ns)
        if sender.leaving and not sender.queue and sender in self._ports:
            self._ports.remove(sender)
        self._deliver(sender, transmission, self._end_ns)

    def _deliver(self, sender: Port, transmission: Transmission, time_ns: int) -> None:
        for port in list(self._ports):
            if port is not sender and not port.leaving and port.state is not State.BUS_OFF:
                port.received(time_ns)
                port.deliver(transmission, time_ns)
