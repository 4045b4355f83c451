"""Reading from SocketCAN: the kernel's time of reception and its count of frames that did not fit.

python-can reads the time stamp but in wall-clock time, selects before each frame, and knows no overflow counter.
"""

from __future__ import annotations

import select
import socket
import struct
from pathlib import Path

import can
from can.interfaces.socketcan.socketcan import dissect_can_frame

from ..kernel_times import ANCILLARY_BYTES, KernelTimes

_SO_MEMINFO = 55
EXTENDED, _REMOTE, _ERROR = 0x80000000, 0x40000000, 0x20000000
_FD_SIZE = 72
_BITRATE_SWITCH, _ERROR_STATE = 0x01, 0x02
_MEMORY = struct.Struct("@9I")  # SK_MEMINFO_..., of which the last is that of drops
_ARPHRD_CAN = "280"
_IFF_UP = 1
NETWORKS = Path("/sys/class/net")


class KernelReader:
    """Frames of a raw CAN socket, each with the time of its reception in CLOCK_MONOTONIC."""

    def __init__(self, raw: socket.socket) -> None:
        self._socket = raw
        self._times = KernelTimes(raw)

    @property
    def fileno(self) -> int:
        """Descriptor of the socket."""
        return self._socket.fileno()

    @property
    def overflows(self) -> int:
        """Frames that did not fit into the socket's queue."""
        return int(_MEMORY.unpack(self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMORY.size))[-1])

    def drain(self, limit: int) -> list[tuple[can.Message, int]]:
        """What is there, `limit` frames at most. Raises OSError."""
        frames: list[tuple[can.Message, int]] = []
        while len(frames) < limit:
            try:
                data, ancillary, _, _ = self._socket.recvmsg(_FD_SIZE, ANCILLARY_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                self._times.queue_is_empty()
                break
            frames.append((frame_of(data), self._times.received_ns(ancillary)))
        return frames

    def wait(self, seconds: float) -> None:
        """Until a frame is there, or so long."""
        select.select([self._socket], [], [], seconds)


def frame_of(frame: bytes) -> can.Message:
    """A ``struct can_frame`` or ``struct canfd_frame`` as python-can has it."""
    word, length, flags, data = dissect_can_frame(frame)
    extended = bool(word & EXTENDED)
    return can.Message(
        arbitration_id=word & (0x1FFFFFFF if extended else 0x7FF),
        is_extended_id=extended,
        is_remote_frame=bool(word & _REMOTE),
        is_error_frame=bool(word & _ERROR),
        is_fd=len(frame) == _FD_SIZE,
        bitrate_switch=bool(flags & _BITRATE_SWITCH),
        error_state_indicator=bool(flags & _ERROR_STATE),
        dlc=length,
        data=data,
    )


def trouble(channel: str, bitrate: int, data_bitrate: int | None) -> str | None:
    """Why the network interface can't be used as it is, and what to do; None if it can."""
    network = NETWORKS / channel
    if not network.exists():
        found = sorted(path.name for path in NETWORKS.iterdir() if _line(path / "type") == _ARPHRD_CAN)
        return f"there is no network interface {channel}; CAN interfaces here: {', '.join(found) or 'none'}"
    if _line(network / "type") != _ARPHRD_CAN:
        return f"the network interface {channel} is not a CAN bus"
    link = f"ip link set {channel}"
    fd = f" dbitrate {data_bitrate} fd on" if data_bitrate else ""
    if not int(_line(network / "flags") or "0", 16) & _IFF_UP:
        return f"{channel} is down; as root: {link} up type can bitrate {bitrate}{fd} restart-ms 100"
    if _line(network / "carrier") == "0":
        return f"{channel} is bus-off; as root: {link} type can restart (after restart-ms 100 it does that by itself)"
    if data_bitrate and int(_line(network / "mtu") or "0") < _FD_SIZE:
        return f"{channel} has no CAN FD; as root: {link} down, then {link} up type can bitrate {bitrate}{fd}"
    return None


def _line(file: Path) -> str | None:
    try:
        return file.read_text().strip()
    except OSError:  # carrier of an interface that is down, or one that went away in between
        return None
