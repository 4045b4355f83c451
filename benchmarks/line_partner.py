"""A device for `line_rates`, in a process of its own: ``python -m benchmarks.line_partner (flood|answer|serve)``.

flood: frames on a pseudo terminal, as fast as they are read. answer: a line of text for each line, on a pseudo
terminal. serve: the same over TCP. It says where it is found: the name of the terminal, or the port.
"""

from __future__ import annotations

import os
import select
import socket
import sys
import tty

import fastcrc

SYNC = b"\xaa\x55"
FRAME_BYTES = 20
COUNTS = 1 << 16
REPLY = b"1=12.5000 \n2=-0.2500 \n3=100.0000\n"
_AT_ONCE = 16  # a pseudo terminal holds 4096 bytes


def main() -> None:
    """Go on until it is killed."""
    kind = sys.argv[1]
    if kind == "serve":
        _serve()
        return
    master, slave = os.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)  # noqa: T201
    if kind == "flood":
        _flood(master)
    else:
        while True:
            if os.read(master, 4096).endswith(b"\n"):
                os.write(master, REPLY)


def _flood(master: int) -> None:
    frames = [_frame(count) for count in range(COUNTS)]
    blocks = [b"".join(frames[first : first + _AT_ONCE]) for first in range(0, COUNTS, _AT_ONCE)]
    os.read(master, 1)  # somebody listens
    os.set_blocking(master, False)
    while True:
        for block in blocks:
            rest = block
            while rest:
                select.select([], [master], [])
                rest = rest[os.write(master, rest) :]


def _frame(count: int) -> bytes:
    body = SYNC + count.to_bytes(2, "little") + bytes(FRAME_BYTES - 6)
    return body + fastcrc.crc16.modbus(body).to_bytes(2, "little")


def _serve() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        print(server.getsockname()[1], flush=True)  # noqa: T201
        while True:
            with server.accept()[0] as client:
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                while client.recv(4096):
                    client.sendall(REPLY)


if __name__ == "__main__":
    main()
