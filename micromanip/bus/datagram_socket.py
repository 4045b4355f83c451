"""A UDP socket opened for compiled code: connected to one device, with a record that system calls can go by."""

from __future__ import annotations

import socket
from typing import Any

import numpy as np

from micromanip.rt.io.context import ADDRESS_BYTES, BATCH, BUFFER, CONTROL, SO_TIMESTAMPNS
from micromanip.rt.io.frames import MAX_BYTES

from .errors import LinkError

_QUEUE_BYTES = 64 * 1024
"""Room for some tens of datagrams: what a loop that stood still finds waiting is old."""


def open_datagrams(host: str, port: int, listen: int | None, timeout_s: float) -> socket.socket:
    """A socket bound to port `listen` (None: any) and connected to `host`; a receive takes `timeout_s` at most.

    The kernel drops what others send from then on. Raises LinkError.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        opened = socket.socket(family, kind, protocol)
    except OSError as problem:
        raise LinkError(f"udp {host}:{port} can't be found: {problem.strerror}") from problem
    try:
        opened.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _QUEUE_BYTES)
        if listen is not None:
            opened.bind(("", listen))
        opened.connect(address)
        opened.settimeout(timeout_s)
    except OSError as problem:
        opened.close()
        raise LinkError(f"udp {host}:{port} can't be opened: {problem.strerror}") from problem
    return opened


def hand_over(opened: socket.socket, record: Any) -> None:
    """Let compiled code of this process have an open socket: `record` is a SOCKET in memory that stays where it is."""
    opened.setblocking(False)
    record["peer"], record["peer_mask"] = _source(opened)
    lend(opened.detach(), record)


def lend(descriptor: int, record: Any) -> None:
    """Let compiled code of this process use a socket that Python goes on owning; it need not be connected."""
    places = {field: record[field].ctypes.data for field in ("name", "buffer", "control", "received")}
    for k in range(BATCH):
        message, buffer = record["message"][k], record["buffer"][k]
        buffer["base"], buffer["length"] = places["received"] + k * MAX_BYTES, MAX_BYTES
        message["name"] = places["name"] + k * ADDRESS_BYTES
        message["buffers"], message["buffer_count"] = places["buffer"] + k * BUFFER.itemsize, 1
        message["control"] = places["control"] + k * CONTROL.itemsize
    record["descriptor"] = descriptor


def _source(opened: socket.socket) -> tuple[Any, Any]:
    """What the kernel puts down as the sender of the device's datagrams, and which of those bytes count."""
    peer, mask = np.zeros(ADDRESS_BYTES, np.uint8), np.zeros(ADDRESS_BYTES, np.uint8)
    host, port = opened.getpeername()[:2]
    address = socket.inet_pton(opened.family, host.partition("%")[0])
    at = 4 if opened.family == socket.AF_INET else 8
    peer[2:4] = np.frombuffer(port.to_bytes(2, "big"), np.uint8)
    peer[at : at + len(address)] = np.frombuffer(address, np.uint8)
    mask[2:4] = mask[at : at + len(address)] = 0xFF
    return peer, mask
