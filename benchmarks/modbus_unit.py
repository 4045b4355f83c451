"""A Modbus TCP unit that answers at once, in a process of its own: ``python -m benchmarks.modbus_unit``.

It looks at hardly more than the transaction number, so that it holds nobody up. Prints its port.
"""

from __future__ import annotations

import contextlib
import socket

REGISTERS_READ, REGISTERS_WRITTEN = 21, 4
_REQUEST_BYTES = 7 + 10 + 2 * REGISTERS_WRITTEN


def main() -> None:
    """Serve one client after the other until it is killed."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print(listener.getsockname()[1], flush=True)  # noqa: T201
        while True:
            client = listener.accept()[0]
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with client, contextlib.suppress(OSError):
                _serve(client)


def _serve(client: socket.socket) -> None:
    while request := client.recv(_REQUEST_BYTES):
        count = request[11]
        client.send(
            request[:4] + (3 + 2 * count).to_bytes(2, "big") + request[6:8] + bytes((2 * count, *bytes(2 * count)))
        )


if __name__ == "__main__":
    main()
