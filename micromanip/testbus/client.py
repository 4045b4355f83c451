"""python-can interface ``micromanip``: takes part in a bus that ``micromanip device simulate`` keeps.

``can.Bus(interface="micromanip", channel="can0", bitrate=1_000_000, data_bitrate=5_000_000, fd=True)``
"""

from __future__ import annotations

import errno
import json
import select
import socket
import time
from typing import NoReturn

import can

from micromanip.bus.can_bits import CLASSIC_LENGTHS, FD_LENGTHS, fd_length

from .client_port import address
from .frame import FD, STAMP, ErrorClass, Frame, pack, unpack

_GREETING_S = 0.5
_GREETING_BYTES = 4096
_PACKET_BYTES = STAMP.size + FD.size
_WAITING_BYTES = 16 << 10
"""Some forty frames: a hub whose process is late finds what was sent meanwhile. The queue proper is the hub's."""


class HubBus(can.BusABC):
    """A controller on a simulated bus; behaves as SocketCAN does.

    ``send`` never waits unless it is given a time-out; a full transmit queue is a CanOperationError with ENOBUFS. A bus
    that went away, or bus-off, is one with ENETDOWN, from ``send`` and ``recv``. Error frames come as messages.
    """

    timestamp_clock = "CLOCK_MONOTONIC"
    """Clock of the messages' time stamps, in seconds: the end of the frame by the time of the bus."""
    packet_stamp_bytes = STAMP.size
    """Packets of the socket are SocketCAN's frames, after so many bytes of a time (ns of CLOCK_MONOTONIC)."""

    def __init__(
        self,
        channel: str,
        can_filters: can.typechecking.CanFilters | None = None,
        *,
        bitrate: int | None = None,
        data_bitrate: int | None = None,
        fd: bool = False,
        receive_own_messages: bool = False,
    ) -> None:
        """Connect to the hub of `channel`; `bitrate` and `data_bitrate`, if given, must be the bus's own.

        Raises CanInitializationError if there is no hub, if it doesn't answer, or if the bus is another one.
        """
        if receive_own_messages:
            raise can.CanInitializationError("interface micromanip can't receive its own messages")
        self.channel = channel
        self.channel_info = f"micromanip channel {channel!r}"
        self.fd = fd
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self._bus_off = False
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._connect(bitrate, data_bitrate)
        except BaseException:
            self._sock.close()
            raise
        super().__init__(channel, can_filters)

    def _connect(self, bitrate: int | None, data_bitrate: int | None) -> None:
        channel = self.channel
        self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _WAITING_BYTES)
        self._sock.settimeout(_GREETING_S)
        try:
            self._sock.connect(address(channel))
            about = self._greeting()
        except (ConnectionRefusedError, ConnectionResetError) as error:
            raise can.CanInitializationError(
                f"no hub for channel {channel}: start `micromanip device simulate` first"
            ) from error
        except OSError as error:
            raise can.CanInitializationError(f"the hub for channel {channel} does not answer: {error}") from error
        self._sock.setblocking(False)
        for name, asked in (("bitrate", bitrate), ("data_bitrate", data_bitrate if self.fd else None)):
            if asked is not None and asked != about.get(name):
                raise can.CanInitializationError(
                    f"the bus on channel {channel} has a {name} of {about.get(name)}, not {asked} as asked for"
                )
        if self.fd and about.get("data_bitrate") is None:
            raise can.CanInitializationError(f"the bus on channel {channel} is a classic one: no CAN FD")

    def _greeting(self) -> dict[str, int | None]:
        packet = self._sock.recv(_GREETING_BYTES)
        if not packet:
            raise ConnectionResetError  # the hub is just ending
        greeting: dict[str, int | None] = json.loads(packet)
        return greeting

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self._bus_off:
            raise can.CanOperationError(f"{self.channel_info} is bus-off", errno.ENETDOWN)
        packet = STAMP.pack(time.monotonic_ns()) + self._packed(msg)
        try:
            self._sock.send(packet)
        except BlockingIOError:
            self._send_later(packet, timeout)
        except OSError as error:
            self._lost(error)

    def _send_later(self, packet: bytes, timeout: float | None) -> None:
        try:
            if timeout and select.select((), (self._sock,), (), timeout)[1]:
                self._sock.send(packet)
                return
        except BlockingIOError:
            pass
        except OSError as error:
            self._lost(error)
        raise can.CanOperationError(f"{self.channel_info}: the transmit queue is full", errno.ENOBUFS)

    def _packed(self, msg: can.Message) -> bytes:
        data = bytes(msg.dlc if msg.is_remote_frame else msg.data)
        if len(data) > (FD_LENGTHS if msg.is_fd else CLASSIC_LENGTHS)[-1]:
            kind = "CAN FD" if msg.is_fd else "CAN"
            raise can.CanOperationError(f"no {kind} frame has {len(data)} bytes", errno.EINVAL)
        if msg.is_fd:
            if not self.fd:
                why = f"{self.channel_info} was opened without fd: no CAN FD frames"
                raise can.CanOperationError(why, errno.EINVAL)
            data = data.ljust(fd_length(len(data)), b"\0")
        flags = msg.is_extended_id, msg.is_fd, msg.bitrate_switch, msg.is_remote_frame
        return pack(Frame(msg.arbitration_id, data, *flags))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        while True:
            try:
                packet = self._sock.recv(_PACKET_BYTES)
            except BlockingIOError:
                if timeout == 0 or not select.select((self._sock,), (), (), timeout)[0]:
                    return None, False
                continue
            except OSError as error:
                self._lost(error)
            if not packet:
                self._lost(None)
            message = self._message(packet)
            if message.is_error_frame:
                self._note(message)
                return message, True
            if self.fd or not message.is_fd:  # a socket that wasn't opened for CAN FD doesn't see its frames
                return message, False

    def _message(self, packet: bytes) -> can.Message:
        time_ns, frame = STAMP.unpack_from(packet)[0], unpack(packet[STAMP.size :])
        return can.Message(
            timestamp=time_ns * 1e-9,
            arbitration_id=frame.identifier,
            is_extended_id=frame.extended,
            is_remote_frame=frame.remote,
            is_error_frame=frame.error,
            channel=self.channel,
            dlc=len(frame.data),
            data=None if frame.remote else frame.data,
            is_fd=frame.fd,
            is_rx=True,
            bitrate_switch=frame.bitrate_switch,
        )

    def _note(self, message: can.Message) -> None:
        """Follow the controller by its error frames."""
        if message.arbitration_id & (ErrorClass.BUS_OFF | ErrorClass.RESTARTED):
            self._bus_off = bool(message.arbitration_id & ErrorClass.BUS_OFF)

    def _lost(self, error: OSError | None) -> NoReturn:
        raise can.CanOperationError(f"{self.channel_info} is down: its hub is gone", errno.ENETDOWN) from error

    def fileno(self) -> int:
        """Descriptor to wait on for messages; -1 after ``shutdown``."""
        return self._sock.fileno()

    def shutdown(self) -> None:
        super().shutdown()
        self._sock.close()
