"""Frames and exchanges a second of the driver `line`, beside bare pyserial and a bare socket with the same device.

The bare ones only read bytes, or send a line and wait for one: they look at nothing. All take turns.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import serial

from micromanip.bus.driver import BusDriver
from micromanip.bus.inbox import Inbox
from micromanip.bus.registry import driver_class
from micromanip.errors import CheckFailed

from .line_partner import FRAME_BYTES, REPLY, SYNC
from .plan import Plan
from .results import Result

FRAMES, EXCHANGES = 20_000, 5_000
_BAUD = 4_000_000
_REQUEST = b"POS? 1 2 3\n"
_NUMBER = {"type": "int32", "byte_order": "little"}
_FRAMES = {
    "binary": {
        "sync": SYNC.hex(),
        "crc": {"name": "crc16.modbus"},
        "receive": {
            "strains": {
                "rate_hz": 2000,
                "bytes": FRAME_BYTES,
                "counter": {"at": 2, "type": "uint16", "byte_order": "little"},
                "fields": {f"strain_{axis}": {"at": 4 + 4 * i, **_NUMBER} for i, axis in enumerate("xyz")},
            }
        },
    }
}
_TEXT = {
    "ascii": {
        "terminator": "LF",
        "read": {
            "strains": {
                "request": _REQUEST.decode().strip(),
                "reply": ["1={strain_x}", "2={strain_y}", "3={strain_z}"],
                "rate_hz": 100,
                "fields": {f"strain_{axis}": {} for axis in "xyz"},
            }
        },
    }
}


def run(plan: Plan) -> list[Result]:
    """The best of the pairs of each."""
    with _partner("flood") as terminal:
        with serial.Serial(terminal, _BAUD) as port:
            port.write(b"?")
        driver = _driver({"serial": {"device": terminal, "baud": _BAUD}, **_FRAMES})
        frames = _best(plan, "line_frames", lambda: _taken(driver), lambda: _read(terminal), FRAMES)
    with _partner("answer") as terminal:
        driver = _driver({"serial": {"device": terminal, "baud": _BAUD}, **_TEXT})
        lines = _best(plan, "line_exchanges", lambda: _asked(driver), lambda: _asked_bare(terminal), EXCHANGES)
    with _partner("serve") as port_number:
        driver = _driver({"tcp": {"host": "127.0.0.1", "port": int(port_number)}, **_TEXT})
        over_tcp = _best(plan, "line_tcp", lambda: _asked(driver), lambda: _asked_socket(int(port_number)), EXCHANGES)
    return [
        Result.of("line_frames", frames[0], "frames/s", "bare pyserial", frames[1]),
        Result.of("line_exchanges", lines[0], "exchanges/s", "bare pyserial", lines[1]),
        Result.of("line_tcp", over_tcp[0], "exchanges/s", "bare socket", over_tcp[1]),
    ]


def _best(plan: Plan, name: str, ours: Callable[[], None], bare: Callable[[], None], count: int) -> tuple[float, float]:
    """Most a second of ours and of the bare one."""
    pairs = []
    for pair in range(plan.pairs):
        plan.tell(f"{name}: pair {pair + 1} of {plan.pairs}")
        pairs.append((_rate_hz(ours, count), _rate_hz(bare, count)))
    best, best_bare = (max(rates) for rates in zip(*pairs, strict=True))
    return best, best_bare


def _rate_hz(work: Callable[[], None], count: int) -> float:
    begin = time.perf_counter()
    work()
    return count / (time.perf_counter() - begin)


def _taken(driver: BusDriver) -> None:
    """As the worker does it: until all samples of the last frame are there."""
    inbox, samples = Inbox(), FRAMES * len(driver.inputs)
    driver.open()
    try:
        while samples > 0:
            driver.receive(inbox, time.monotonic_ns() + 1_000_000)
            samples -= len(inbox)
            inbox.clear()
    finally:
        driver.close()


def _read(terminal: str) -> None:
    with serial.Serial(terminal, _BAUD, timeout=1.0) as port:
        for _ in range(FRAMES):
            if len(port.read(FRAME_BYTES)) < FRAME_BYTES:
                raise CheckFailed("frames of the flood are missing")


def _asked(driver: BusDriver) -> None:
    inbox = Inbox()
    driver.open()
    try:
        for _ in range(EXCHANGES):
            driver.perform(0, (), inbox)
            if len(inbox) != len(driver.inputs):
                raise CheckFailed("an answer is missing")
            inbox.clear()
    finally:
        driver.close()


def _asked_bare(terminal: str) -> None:
    with serial.Serial(terminal, _BAUD, timeout=1.0) as port:
        for _ in range(EXCHANGES):
            port.write(_REQUEST)
            if port.read(len(REPLY)) != REPLY:
                raise CheckFailed("an answer is missing")


def _asked_socket(port: int) -> None:
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for _ in range(EXCHANGES):
            connection.sendall(_REQUEST)
            if connection.recv(4096) != REPLY:
                raise CheckFailed("an answer is missing")


def _driver(options: dict[str, Any]) -> BusDriver:
    kind = driver_class("line")
    assert issubclass(kind, BusDriver)
    return kind(kind.Options.model_validate(options), Path())


@contextmanager
def _partner(kind: str) -> Iterator[str]:
    """A device; where it is found."""
    root = Path(__file__).parent.parent
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-m", "benchmarks.line_partner", kind]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=root, env=environment, text=True) as process:
        try:
            assert process.stdout is not None
            where = process.stdout.readline().strip()
            if not where:
                raise CheckFailed("the process that plays the device did not start")
            yield where
        finally:
            process.kill()
