"""Each register of the configuration as it would read under every order: what looks right is the device's order."""

from __future__ import annotations

import contextlib
import itertools
import struct
import time
from collections.abc import Iterator, Sequence
from typing import Any

from micromanip.driver import Answer, DeviceFault, LinkError, TransientError

from .client import Client
from .codec import Field, ReadPlan
from .exchange import Block, Exchange
from .hello import single
from .options import ModbusOptions, Unit
from .task_options import WRITES, Register, Task

_ORDERS = ("big", "little")
_OPEN_NS = 900_000_000
_PAUSE_S = 0.1
_REGISTERS = {3: "holding registers", 4: "input registers"}
_MOST, _AT_ONCE = 128, 8
"""Registers that are looked at, and those of one request: a device refuses one that goes beyond its last."""
_READ_BACK = {"coils": 1, "holding registers": 3}
"""Function that reads what a function writes."""


def probe(options: ModbusOptions, client: Client, seconds: float) -> Iterator[Answer]:
    """Ask for all registers, again and again, for so long; nothing is written. Raises LinkError."""
    begin_ns = time.monotonic_ns()
    client.open(begin_ns + _OPEN_NS)
    end_ns = time.monotonic_ns() + round(seconds * 1e9)
    questions = list(_questions(options))
    for first in itertools.count():
        for unit, name, register, exchange in questions:
            if first and time.monotonic_ns() >= end_ns:
                return
            yield _asked(client, unit, name, register, exchange)
        if (left_ns := end_ns - time.monotonic_ns()) <= 0:
            return
        time.sleep(min(_PAUSE_S, left_ns * 1e-9))


def discover(options: ModbusOptions, client: Client, seconds: float) -> Iterator[Answer]:
    """Which units there are, and what their first registers hold; each is asked, none is written to. Raises LinkError.

    Asked until `seconds` are over; those that a network's converters and single devices usually have come first.
    """
    end_ns = time.monotonic_ns() + round(seconds * 1e9)
    with contextlib.closing(client):
        client.open(time.monotonic_ns() + _OPEN_NS)
        for unit_id in dict.fromkeys((1, 255, 0, *range(2, 248))):
            if unit_id == 0 and options.serial is not None:
                continue  # a broadcast
            for function, kind in _REGISTERS.items():
                if time.monotonic_ns() > end_ns:
                    return
                words = _first_registers(client, unit_id, function)
                if words is None:
                    break
                said = {f"{first}-{first + len(some) - 1}": " ".join(map(str, some)) for first, some in words.items()}
                yield Answer(f"unit {unit_id}, {kind}", said, "" if said else "it answers, and has none of them")


def _first_registers(client: Client, unit_id: int, function: int) -> dict[int, Sequence[int]] | None:
    """Codes by the address of the first; None where nobody answers."""
    found: dict[int, Sequence[int]] = {}
    for first in range(0, _MOST, _AT_ONCE):
        exchange = Exchange(unit_id, f"unit {unit_id}", function, Block(first, _AT_ONCE, ()), None)
        try:
            data = _data(client, exchange)
        except DeviceFault:
            continue
        except (TransientError, LinkError):
            client.forgive()
            return found or None
        found[first] = struct.unpack(f">{_AT_ONCE}H", data)
    return found


def _data(client: Client, exchange: Exchange) -> bytes:
    """What comes for it. Raises TransientError, DeviceFault, LinkError."""
    client.drain(time.monotonic_ns() + _OPEN_NS)
    client.ask(exchange, exchange.request({}))
    answer = None
    while answer is None and client.waits:
        answer = client.answer(time.monotonic_ns() + _OPEN_NS)
    if answer is None:
        raise TransientError("no answer")
    return answer.pdu[2:]


def _asked(client: Client, unit: Unit, name: str, register: Register, exchange: Exchange) -> Answer:
    values: dict[str, Any] = {"address": register.address, "type": register.type}
    try:
        data = _data(client, exchange)
    except (TransientError, DeviceFault) as problem:
        return Answer(name, values, str(problem), is_value=False)
    values["on the wire"] = data.hex(" ")
    if register.type == "coil":
        return Answer(name, {**values, "value": exchange.values(bytes(2) + data)[0]})
    configured = _order(unit.byte_order, unit.word_order if register.count > 1 else None)
    return Answer(name, {**values, **_orders(register, data)}, f"configured: {configured}")


def _orders(register: Register, data: bytes) -> dict[str, float]:
    """Its value under each order that makes a difference."""
    words = _ORDERS if register.count > 1 else _ORDERS[:1]
    return {
        _order(byte_order, word_order if register.count > 1 else None): ReadPlan(
            [Field("", register, 0, byte_order, word_order)]
        ).values(data)[0]
        for word_order in words
        for byte_order in _ORDERS
    }


def _order(byte_order: str, word_order: str | None) -> str:
    return f"bytes {byte_order}" + (f", words {word_order}" if word_order else "")


def _questions(options: ModbusOptions) -> Iterator[tuple[Unit, str, Register, Exchange]]:
    """What can be asked for without a write."""
    for unit_name, unit in options.units.items():
        for task_name, task in unit.tasks.items():
            for name, register, function in _registers(task_name, task):
                title = f"{unit_name}.{name}"
                yield unit, title, register, single(title, unit, function, register, title)


def _registers(task_name: str, task: Task) -> Iterator[tuple[str, Register, int]]:
    reading = 3 if task.function == 23 else task.function
    for name, register in task.read.items():
        yield name, register, reading
    for key, own in (("status", task.status), ("counter", task.counter)):
        if own is not None:
            yield f"{task_name}, {key}", own, reading
    for name, output in task.write.items():
        yield name, output, _READ_BACK[WRITES[task.function]]
