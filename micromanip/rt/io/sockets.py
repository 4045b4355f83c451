"""System calls of descriptors that do not block, as compiled code makes them: datagrams, terminals, TCP, a file.

A socket for datagrams is opened and connected by Python (``bus/datagram_socket.py``). A call costs some 1 us where
nothing has come, and never waits. The kernel stamps each datagram by the wall clock, which may be stepped. So the stamp
counts only within certain bounds: after the datagram before it, after the queue was last seen empty, and before now.
"""

from __future__ import annotations

from typing import Any

from numba import types

from micromanip.rt.intrinsics import last_error, now_ns, system_call, wall_ns
from micromanip.rt.jit import compiled

from .context import ADDRESS_BYTES, BATCH, CONTROL, SO_TIMESTAMPNS

POLLIN = 1
"""What is asked of a descriptor, in a ``struct pollfd``: whether something is there to be received."""
WOULD_BLOCK, REFUSED = 11, 111
"""Nothing is there, or no room is left; nobody listens at the other end, which the system said in answer to a datagram
before."""

_DONT_WAIT, _NO_SIGNAL, _TRUNCATED = 0x40, 0x4000, 0x20
_SECOND_NS = 1_000_000_000
_SOL_SOCKET = 1
_CONTROL_BYTES = CONTROL.itemsize

_recvmmsg = system_call("recvmmsg", types.int32, types.int32, types.intp, types.uint32, types.int32, types.intp)
_send = system_call("send", types.int64, types.int32, types.intp, types.uint64, types.int32)
_sendto = system_call(
    "sendto", types.int64, types.int32, types.intp, types.uint64, types.int32, types.intp, types.uint32
)
_read = system_call("read", types.int64, types.int32, types.intp, types.uint64)
_write = system_call("write", types.int64, types.int32, types.intp, types.uint64)
_pwrite = system_call("pwrite", types.int64, types.int32, types.intp, types.uint64, types.int64)
_ioctl = system_call("ioctl", types.int32, types.int32, types.uint64, types.intp)
_ppoll = system_call("ppoll", types.int32, types.intp, types.uint64, types.intp, types.intp)
_close = system_call("close", types.int32, types.int32)


@compiled
def wait(poll: Any, descriptor: int, for_ns: int, timespec: Any) -> int:
    """Until something is there to be received, or so long: 1, 0, or less than 0 for a signal.

    `poll` is scratch for a ``struct pollfd``, int32 (2,), `timespec` int64 (2,).
    """
    poll[0], poll[1] = descriptor, POLLIN
    return wait_for_any(poll, 1, for_ns, timespec)


@compiled
def wait_for_any(poll: Any, count: int, for_ns: int, timespec: Any) -> int:
    """The same for so many descriptors: `poll` is a ``struct pollfd`` for each.

    The upper half of its second number says what is there.
    """
    left_ns = max(0, for_ns)
    timespec[0], timespec[1] = left_ns // _SECOND_NS, left_ns % _SECOND_NS
    return _ppoll(poll.ctypes.data, count, timespec.ctypes.data, 0)


@compiled
def receive(s: Any) -> int:
    """Take what has come, at most BATCH datagrams; how many, or minus an error number."""
    for k in range(BATCH):
        message = s["message"][k]
        message["name_bytes"], message["control_bytes"], message["flags"] = ADDRESS_BYTES, _CONTROL_BYTES, 0
    count = _recvmmsg(s["descriptor"], s["message"].ctypes.data, BATCH, _DONT_WAIT, 0)
    # the monotonic clock first: if this process is stalled in between, a datagram looks older, never newer than it is
    s["now_ns"] = now_ns(s["timespec"])
    s["wall_ns"] = wall_ns(s["timespec"])
    if count >= 0:
        return count
    error = last_error()
    if error == WOULD_BLOCK:
        s["earliest_ns"] = s["now_ns"]
        return 0
    return -error


@compiled
def length_of(s: Any, k: int) -> int:
    """How many bytes datagram `k` has; -1 where it has more than there is room for."""
    message = s["message"][k]
    return -1 if message["flags"] & _TRUNCATED != 0 else int(message["length"])


@compiled
def is_from_peer(s: Any, k: int) -> bool:
    """Whether datagram `k` comes from the address and port that the socket is connected to."""
    differs = 0
    for i in range(ADDRESS_BYTES):
        differs |= (s["name"][k][i] ^ s["peer"][i]) & s["peer_mask"][i]
    return differs == 0


@compiled
def received_ns(s: Any, k: int) -> int:
    """When datagram `k` came, CLOCK_MONOTONIC; now, where the kernel doesn't say."""
    control = s["control"][k]
    if s["message"][k]["control_bytes"] < _CONTROL_BYTES or control["level"] != _SOL_SOCKET:
        return s["now_ns"]
    if control["kind"] != SO_TIMESTAMPNS:
        return s["now_ns"]
    ago_ns = s["wall_ns"] - (control["seconds"] * _SECOND_NS + control["nanoseconds"])
    s["earliest_ns"] = min(s["now_ns"], max(s["earliest_ns"], s["now_ns"] - ago_ns))
    return s["earliest_ns"]


@compiled
def send(s: Any, length: int) -> int:
    """Send so many bytes of `sent` as one datagram: 0, or an error number.

    If the system reports here that nobody listened to a datagram before, this one is sent again.
    """
    for _ in range(2):
        if _send(s["descriptor"], s["sent"].ctypes.data, length, _DONT_WAIT | _NO_SIGNAL) >= 0:
            return 0
        error = last_error()
        if error != REFUSED:
            break
    return error


@compiled
def send_back(s: Any, k: int, length: int) -> int:
    """Send so many bytes of `sent` to who has sent datagram `k`, from a socket that is not connected: 0, or an error
    number.
    """
    name = s["message"][k]
    flags = _DONT_WAIT | _NO_SIGNAL
    sent = _sendto(s["descriptor"], s["sent"].ctypes.data, length, flags, name["name"], name["name_bytes"])
    return 0 if sent >= 0 else last_error()


@compiled
def close(s: Any) -> None:
    """Close the socket; may be called twice."""
    if s["descriptor"] >= 0:
        _close(s["descriptor"])
        s["descriptor"] = -1


@compiled
def read_bytes(descriptor: int, place: int, most: int) -> int:
    """What is there, at most so many bytes, to an address: how many, 0 where the other end is gone, minus an error
    number.
    """
    count = _read(descriptor, place, most)
    return count if count >= 0 else -last_error()


@compiled
def write_bytes(descriptor: int, place: int, count: int) -> int:
    """Hand over so many bytes from an address: how many the system took, or minus an error number."""
    taken = _write(descriptor, place, count)
    return taken if taken >= 0 else -last_error()


@compiled
def write_at(descriptor: int, words: Any, at: int) -> int:
    """Write `words` of 8 bytes into a file, from `at` on: 0, or minus an error number."""
    return 0 if _pwrite(descriptor, words.ctypes.data, 8 * len(words), at) >= 0 else -last_error()


@compiled
def ask(descriptor: int, request: int, place: int) -> int:
    """An ``ioctl`` that answers with a number (int32) at an address: 0, or minus an error number."""
    return 0 if _ioctl(descriptor, request, place) >= 0 else -last_error()
