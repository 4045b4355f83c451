"""What kind of network interface the kernel says that it is: "vcan", "can", ...; asked by netlink (rtnetlink(7))."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

VIRTUAL_KINDS = ("vcan", "vxcan")

_HEADER = struct.Struct("=IHHII")
"""struct nlmsghdr: length, type, flags, number, port."""
_LINK_HEADER_BYTES = 16
_ATTRIBUTE = struct.Struct("=HH")
"""struct rtattr: length, type."""
_GETLINK, _NEWLINK, _REQUEST = 18, 16, 1
_LINKINFO, _KIND = 18, 1
_TYPE_MASK = 0x3FFF
_TIMEOUT_S = 1.0


def kind_of_link(name: str) -> str | None:
    """Kind of the interface `name`, "" for hardware that has none; None where the kernel can't be asked."""
    try:
        index = socket.if_nametoindex(name)
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 0) as kernel:  # 0: NETLINK_ROUTE
            kernel.settimeout(_TIMEOUT_S)
            kernel.sendto(request(index), (0, 0))
            return kind_in(kernel.recv(65_536))
    except OSError:  # no such interface, or a service that may not
        return None


def request(index: int) -> bytes:
    """A message that asks for the link with this index."""
    link = struct.pack("=BxHiII", 0, 0, index, 0, 0)
    return _HEADER.pack(_HEADER.size + len(link), _GETLINK, _REQUEST, 1, 0) + link


def kind_in(answer: bytes) -> str | None:
    """The kind that an answer names, "" where it names none; None where it is no answer but an error."""
    length, kind, *_ = _HEADER.unpack_from(answer)
    if kind != _NEWLINK:
        return None
    for link_type, link_value in _attributes(answer[_HEADER.size + _LINK_HEADER_BYTES : length]):
        if link_type == _LINKINFO:
            for info_type, info_value in _attributes(link_value):
                if info_type == _KIND:
                    return info_value.rstrip(b"\0").decode("ascii", "replace")
    return ""


def _attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    while len(data) >= _ATTRIBUTE.size:
        length, kind = _ATTRIBUTE.unpack_from(data)
        if length < _ATTRIBUTE.size:
            return
        yield kind & _TYPE_MASK, data[_ATTRIBUTE.size : length]
        data = data[(length + 3) & ~3 :]
