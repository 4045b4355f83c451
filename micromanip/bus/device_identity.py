"""Which device a name leads to: two names of one piece of hardware are one device.

A driver calls its device by a path, "tcp HOST:PORT", "udp HOST:PORT", "socketcan-INTERFACE", "ethercat INTERFACE", or
by any other text, of which nothing more is known.
"""

from __future__ import annotations

import functools
import ipaddress
import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

_PTS = Path("/dev/pts")
_INTERFACES = Path("/sys/class/net")
_CAN, _ETHERCAT = "socketcan-", "ethercat "
_PAIR = "veth"
_ARPHRD_CAN = "280"

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


def identities(device: str) -> frozenset[str]:
    """The name as it is, and what it leads to at this moment: two devices that share one of them are the same.

    The name stays among them: an adapter that is replugged while it is in use gets another path, and keeps its name.
    A host that has a name is looked up, which takes as long as the network needs.
    """
    return frozenset((device, *_leads_to(device)))


def identity(device: str) -> str:
    """The one of its identities that has least to do with how it was called, for what is remembered of it."""
    return device if _interface(device) else min(_leads_to(device), default=device)


def real_because(device: str) -> str | None:
    """Why what stands behind the name may move something real; None where it is emulated, or nothing is known (yet)."""
    if device.startswith("/"):
        return _real_path(Path(device))
    if host := _host(device):
        found = _addresses(host[1])
        if not found:
            return f"{host[1]} can't be looked up, so it is not seen to be this machine"
        return None if all(map(_is_loopback, found)) else f"{host[1]} is not this machine"
    if device.startswith(_ETHERCAT):
        return _real_line(device.removeprefix(_ETHERCAT))
    return _real_interface(device.removeprefix(_CAN)) if device.startswith(_CAN) else None


def _leads_to(device: str) -> set[str]:
    if device.startswith("/"):
        return {os.path.realpath(device)}
    if host := _host(device):
        protocol, name, port = host
        found = _addresses(name)
        return {f"{protocol} {'loopback' if _is_loopback(address) else address}:{port}" for address in found}
    if interface := _interface(device):
        try:
            return {f"interface {socket.if_nametoindex(interface)}"}
        except OSError:
            return set()
    return set()


def _interface(device: str) -> str | None:
    """The network interface of such a name; None for another kind of name."""
    return next((device.removeprefix(kind) for kind in (_CAN, _ETHERCAT) if device.startswith(kind)), None)


def _host(device: str) -> tuple[str, str, str] | None:
    """Protocol, host and port of "tcp HOST:PORT"; None for another kind of name."""
    protocol, _, rest = device.partition(" ")
    host, _, port = rest.rpartition(":")
    return (protocol, host.strip("[]"), port) if protocol in ("tcp", "udp") and host else None


@functools.lru_cache(maxsize=64)
def _addresses(host: str) -> frozenset[Address]:
    """All addresses of a host, none where it is unknown; asked once, for a network may take seconds to answer."""
    try:
        found = {str(entry[4][0]) for entry in socket.getaddrinfo(host, None)}
        addresses = [ipaddress.ip_address(text) for text in found]
    except (OSError, UnicodeError, ValueError):
        return frozenset()
    return frozenset(getattr(address, "ipv4_mapped", None) or address for address in addresses)


def _is_loopback(address: Address) -> bool:
    return address.is_loopback or address.is_unspecified  # the kernel takes "any" for itself


def _real_path(path: Path) -> str | None:
    real = Path(os.path.realpath(path))
    name = str(path) if real == path else f"{path} ({real})"
    if real.is_relative_to(_PTS):
        return None
    if real.is_char_device() or real.is_block_device():
        return f"{name} is no pseudo terminal"
    # a link that device simulate has not made yet leads nowhere
    return f"{name} is not there, so it is not seen to be a pseudo terminal" if real.is_relative_to("/dev") else None


def _real_line(name: str) -> str | None:
    """Terminals are emulated at the far end of a veth pair, and only there."""
    if not (_INTERFACES / name).is_dir() or kind_of_link(name) == _PAIR:
        return None
    return f"{name} is not seen to be a veth pair"


def _real_interface(name: str) -> str | None:
    folder = _INTERFACES / name
    if not folder.is_dir():
        return None
    kind = kind_of_link(name)
    if kind is not None:
        return None if kind in VIRTUAL_KINDS else f"{name} is no virtual interface"
    # a service may not ask the kernel for it: hardware has a device, with the exception of slcan
    is_can = (folder / "type").read_text(encoding="ascii").strip() == _ARPHRD_CAN
    return None if is_can and not (folder / "device").exists() else f"{name} is no virtual interface"


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
