"""Packets sent as fast as somebody listens, in compiled code: whoever is slower is not the sender."""

from typing import Any

from numba import types

from micromanip.rt.io.sockets import write_bytes
from micromanip.rt.jit import Compiler

_compiled = Compiler(__file__)


@_compiled.entry(types.int64(types.int32, types.uint8[:, ::1]))
def flood(descriptor: int, packets: Any) -> int:
    """Send all `packets` (frames, bytes) to a socket that blocks; 0, or minus an error number."""
    for k in range(len(packets)):
        sent = write_bytes(descriptor, packets[k].ctypes.data, packets.shape[1])
        if sent < 0:
            return sent
    return 0
