"""A simulated CAN bus: nodes of this process and clients of other processes on one wire, and faults on demand."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from functools import partial

from micromanip.errors import DeviceUnavailable

from .client_port import ClientPort, address
from .event_loop import EventLoop
from .fault import Delivery
from .faults import Faults
from .frame import Frame, pack, unpack
from .port import Node, NodePort, Port, State, Transmission
from .wire import Statistics, Wire

QUEUE_FRAMES = 10
"""Frames that a participant can have waiting: the queue length of SocketCAN devices."""
_BACKLOG = 16
_RECOVERY_BITS = 128 * 11
"""What a controller in bus-off waits for before it takes part again, if it does so by itself (ISO 11898-1)."""


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
        seed: int = 0,
    ) -> None:
        """A bus at `bitrate`, with `data_bitrate` one for CAN FD.

        A node of this process that goes bus-off recovers by itself, a client when it connects again. `seed` is that of
        the injected faults. Raises DeviceUnavailable if `channel` has a hub already.
        """
        self.channel = channel
        self.bitrate = bitrate
        self.data_bitrate = data_bitrate
        self.faults = Faults(self, channel, loop, seed)
        self._loop = loop
        self._wire = Wire(loop, bitrate, data_bitrate, self.faults)
        self._queue_frames = queue_frames
        self._node_restart_ns = round(_RECOVERY_BITS / bitrate * 1e9)
        self._nodes: dict[int, NodePort] = {}
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        try:
            self._listener.bind(address(channel))
        except OSError as error:
            self._listener.close()
            raise DeviceUnavailable(
                f"channel {channel} is simulated by another process already; stop it, or choose another channel"
            ) from error
        self._listener.listen(_BACKLOG)
        loop.add_reader(self._listener.fileno(), self._accept)

    def attach(self, node: Node) -> None:
        """Let a node of this process take part: its ``on_frame`` gets what the others send."""
        port = self._nodes[id(node)] = NodePort(node, self._queue_frames, self._node_restart_ns)
        self.join(port)

    def detach(self, node: Node) -> None:
        """Take a node off the bus, with what it has queued: it was switched off."""
        self.leave(self._nodes.pop(id(node)))

    def send(self, node: Node, frame: Frame, time_ns: int | None = None) -> bool:
        """Queue a frame of an attached node; False if its queue is full or it is bus-off, and the frame lost.

        `time_ns` is when it was ready, for a node whose timer came late; None is now, or for one that answers from
        ``on_frame`` the end of the frame that it got. Raises ValueError for a frame that the bus can't carry.
        """
        port = self._nodes[id(node)]
        if port.full or port.state is State.BUS_OFF:
            return False
        now_ns = self._wire.now_ns()
        arrival_ns = now_ns if time_ns is None else min(time_ns, now_ns)
        self._wire.enqueue(port, self._wire.transmission(frame, pack(frame), arrival_ns))
        return True

    def transmission(self, frame: Frame) -> Transmission:
        """A frame for the queue of a participant of one's own making, as of now."""
        return self._wire.transmission(frame, pack(frame), self.now_ns())

    @property
    def statistics(self) -> Statistics:
        """What went over the bus so far."""
        return self._wire.statistics

    @property
    def clients(self) -> Iterator[ClientPort]:
        """Those that are connected from other processes."""
        return (port for port in self._wire.ports if isinstance(port, ClientPort) and not port.leaving)

    def now_ns(self) -> int:
        """The time of the bus's clock."""
        return self._loop.now_ns()

    def join(self, port: Port) -> None:
        """Let any kind of participant take part."""
        self._wire.join(port)

    def leave(self, port: Port) -> None:
        """Take a participant off the bus; does no harm twice."""
        self._wire.leave(port)

    def hand_over(self, delivery: Delivery) -> None:
        """Give a frame that was held back to all but its sender."""
        self._wire.hand_over(delivery)

    def close(self) -> None:
        """End the bus: clients find their connection closed."""
        self.faults.clear()
        self._loop.remove_reader(self._listener.fileno())
        self._listener.close()
        for client in list(self.clients):
            client.close()
        self._wire.close()

    def _accept(self) -> None:
        try:
            sock = self._listener.accept()[0]
        except OSError:
            return  # it changed its mind
        client = ClientPort(sock, self._loop, self._queue_frames)
        client.listen(self._on_packet, self._on_gone)
        self.join(client)
        client.greet(bitrate=self.bitrate, data_bitrate=self.data_bitrate)

    def _on_packet(self, client: ClientPort, time_ns: int, packed: bytes) -> None:
        transmission = self._wire.transmission(unpack(packed), packed, min(time_ns, self.now_ns()))
        # Not at once: if the loop comes late, what its timers are to do before that time comes first.
        self._loop.call_at(transmission.arrival_ns, partial(self._wire.enqueue, client, transmission))

    def _on_gone(self, client: ClientPort) -> None:
        if not client.queue:
            self.leave(client)
