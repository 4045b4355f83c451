"""HOST:PORT as options have it, and sockets that listen there."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
from collections.abc import Iterator

from micromanip.errors import DeviceUnavailable, PermissionDenied, UsageError


def parsed_address(listen: str, option: str) -> tuple[str, int]:
    """Host and port of `listen`, HOST:PORT, as `option` has it; UsageError for anything else."""
    host, separator, port = listen.rpartition(":")
    if not separator or not port.isdigit() or int(port) > 65535 or not host:
        raise UsageError(f"{option} {listen}: expected HOST:PORT, such as 127.0.0.1:8090 or [::1]:8090")
    return host.strip("[]"), int(port)


def shown(host: str, port: int) -> str:
    """As an address has them."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def is_local(host: str) -> bool:
    """Whether only this computer reaches it."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@contextlib.contextmanager
def listening(host: str, port: int, option: str) -> Iterator[socket.socket]:
    """A socket there, for `option`; PermissionDenied or DeviceUnavailable where none can be."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as made:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            made.bind((host, port))
        except PermissionError as problem:
            raise PermissionDenied(f"{option} {host}:{port}: {problem.strerror}; take a port from 1024 on") from problem
        except OSError as problem:
            raise DeviceUnavailable(
                f"{option} {host}:{port}: {problem.strerror or problem}; choose another address or port"
            ) from problem
        yield made
