"""A device that sends as fast as it is listened to: ``python -m benchmarks.can_flood CHANNEL N``.

It stands in for the hub of the test bus, without a bus time: N frames to each client, one client after the other. It
sends in compiled code, so that whoever is slower is not the sender.
"""

from __future__ import annotations

import json
import socket
import sys
from typing import Any

import numpy as np
from numba import types

from micromanip.rt.jit import Compiler, prepare
from micromanip.rt.wire.byte_stream import write_bytes
from micromanip.testbus.client_port import address
from micromanip.testbus.frame import STAMP, Frame, pack

SENSORS, LENGTH = 0x101, 24
BITRATE, DATA_BITRATE = 1_000_000, 5_000_000

_compiled = Compiler(__file__)


@_compiled.entry(types.int64(types.int32, types.uint8[:, ::1]))
def flood(descriptor: int, packets: Any) -> int:
    """Send all `packets` (frames, bytes) to a socket that blocks; 0, or minus an error number."""
    for k in range(len(packets)):
        sent = write_bytes(descriptor, packets[k].ctypes.data, packets.shape[1])
        if sent < 0:
            return sent
    return 0


def main() -> None:
    """Serve until it is killed; says "ready" once clients may come."""
    channel, count = sys.argv[1], int(sys.argv[2])
    packets = np.array([list(_packet(i)) for i in range(count)], np.uint8)
    prepare(flood)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(address(channel))
        listener.listen()
        print("ready", flush=True)  # noqa: T201
        while True:
            client = listener.accept()[0]
            client.send(json.dumps({"bitrate": BITRATE, "data_bitrate": DATA_BITRATE}).encode())
            try:
                flood(client.fileno(), packets)
                client.recv(1)  # until it has gone
            except OSError:
                continue


def _packet(i: int) -> bytes:
    """Sensors of `can/manipulator.dbc`, zeros but for the counter in the last two bytes."""
    data = bytes(LENGTH - 2) + (i % (1 << 16)).to_bytes(2, "little")
    return STAMP.pack(0) + pack(Frame(SENSORS, data, fd=True, bitrate_switch=True))


if __name__ == "__main__":
    main()
