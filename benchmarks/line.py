"""Frames and exchanges a second of the driver `line`, beside bare pyserial and a bare socket with the same device.

The bare ones only read bytes, or send a line and wait for one: they look at nothing. All take turns.
"""

from __future__ import annotations

import socket
import time

import serial

from micromanip.errors import CheckFailed

from .exchange import best, driver_of, partner, perform, receive
from .partners import FRAME_BYTES, REPLY, SYNC
from .runner import Plan, Result

FRAMES, EXCHANGES = 20_000, 5_000
_BAUD = 4_000_000
_REQUEST = b"POS? 1 2 3\n"
_NUMBER = {"type": "int32", "byte_order": "little"}
_STRAINS = {
    "rate_hz": 2000,
    "bytes": FRAME_BYTES,
    "counter": {"at": 2, "type": "uint16", "byte_order": "little"},
    "fields": {f"strain_{axis}": {"at": 4 + 4 * i, **_NUMBER} for i, axis in enumerate("xyz")},
}
_FRAMES = {"binary": {"sync": SYNC.hex(), "crc": {"name": "crc16.modbus"}, "receive": {"strains": _STRAINS}}}
_READ = {
    "request": _REQUEST.decode().strip(),
    "reply": ["1={strain_x}", "2={strain_y}", "3={strain_z}"],
    "rate_hz": 100,
    "fields": {f"strain_{axis}": {} for axis in "xyz"},
}
_TEXT = {"ascii": {"terminator": "LF", "read": {"strains": _READ}}}


def run(plan: Plan) -> list[Result]:
    """The best of the pairs of each."""
    clock = time.perf_counter
    with partner("frames") as terminal:
        with serial.Serial(terminal, _BAUD) as port:
            port.write(b"?")
        driver = driver_of("line", {"serial": {"device": terminal, "baud": _BAUD}, **_FRAMES})
        plays = (lambda: receive(driver, FRAMES), lambda: _read(terminal))
        frames, bare_frames = best(plan, "line_frames", FRAMES, plays, clock)
    with partner("answer") as terminal:
        asking = driver_of("line", {"serial": {"device": terminal, "baud": _BAUD}, **_TEXT})
        plays = (lambda: perform(asking, EXCHANGES), lambda: _ask(terminal))
        lines, bare_lines = best(plan, "line_exchanges", EXCHANGES, plays, clock)
    with partner("serve") as port_number:
        place = ("127.0.0.1", int(port_number))
        remote = driver_of("line", {"tcp": {"host": place[0], "port": place[1]}, **_TEXT})
        plays = (lambda: perform(remote, EXCHANGES), lambda: _ask_socket(place))
        packets, bare_packets = best(plan, "line_tcp", EXCHANGES, plays, clock)
    return [
        Result.of("line_frames", frames, "frames/s", "bare pyserial", bare_frames),
        Result.of("line_exchanges", lines, "exchanges/s", "bare pyserial", bare_lines),
        Result.of("line_tcp", packets, "exchanges/s", "bare socket", bare_packets),
    ]


def _read(terminal: str) -> None:
    with serial.Serial(terminal, _BAUD, timeout=1.0) as port:
        for _ in range(FRAMES):
            if len(port.read(FRAME_BYTES)) < FRAME_BYTES:
                raise CheckFailed("frames of the flood are missing")


def _ask(terminal: str) -> None:
    with serial.Serial(terminal, _BAUD, timeout=1.0) as port:
        for _ in range(EXCHANGES):
            port.write(_REQUEST)
            if port.read(len(REPLY)) != REPLY:
                raise CheckFailed("an answer is missing")


def _ask_socket(place: tuple[str, int]) -> None:
    with socket.create_connection(place) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for _ in range(EXCHANGES):
            connection.sendall(_REQUEST)
            if connection.recv(4096) != REPLY:
                raise CheckFailed("an answer is missing")
