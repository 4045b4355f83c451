"""Each register of the configuration as it would read under every order: what looks right is the device's order."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from typing import Any

from micromanip.driver import Answer, DeviceFault, TransientError

from .client import Client
from .codec import Field, ReadPlan
from .exchange import Exchange
from .hello import single
from .options import ModbusOptions, Unit
from .task_options import WRITES, Register, Task

_ORDERS = ("big", "little")
_OPEN_NS = 900_000_000
_PAUSE_S = 0.1
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


def _asked(client: Client, unit: Unit, name: str, register: Register, exchange: Exchange) -> Answer:
    values: dict[str, Any] = {"address": register.address, "type": register.type}
    client.drain(time.monotonic_ns() + _OPEN_NS)
    try:
        client.ask(exchange, exchange.request({}))
        answer = None
        while answer is None and client.waits:
            answer = client.answer(time.monotonic_ns() + _OPEN_NS)
    except (TransientError, DeviceFault) as problem:
        return Answer(name, values, str(problem), is_value=False)
    if answer is None:
        return Answer(name, values, "no answer", is_value=False)
    data = answer.pdu[2:]
    values["on the wire"] = data.hex(" ")
    if register.type == "coil":
        return Answer(name, {**values, "value": exchange.values(answer.pdu)[0]})
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
