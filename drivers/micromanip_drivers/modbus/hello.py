"""Who is there, and what it says: nothing is written.

Each unit is asked for a register, and for those that say which device it is, before anything moves. A probe shows each
register of the configuration as it would read under every order: what looks right is the device's order.
"""

from __future__ import annotations

import contextlib
import itertools
import struct
import time
from collections.abc import Iterator, Sequence
from typing import Any

from micromanip.driver import Answer, BusError, DeviceFault, IdentityMismatch, LinkError, PartMissing, TransientError

from .client import OPEN_NS, Client
from .codec import Field, ReadPlan
from .exchange import Block, Exchange
from .options import READ_BACK, WRITES, Expected, ModbusOptions, Register, Task, Unit
from .plan import TaskPlan

_TRIES = 3


def greet(client: Client, options: ModbusOptions, plans: Sequence[TaskPlan], until_ns: int) -> None:
    """Ask all units, until `until_ns` at the latest. Raises LinkError, IdentityMismatch, DeviceFault.

    A unit that is only written to, and has no identity, can't be asked: nothing is known to be readable. Where some
    do not answer, or refuse to be read, PartMissing names the tasks that can't be done, if any with outputs can.
    """
    names = sorted(options.units, key=lambda name: not _tasks(name, plans, writing=True))  # outputs first
    missing: set[int] = set()
    problems: list[BusError] = []
    for left, name in zip(range(len(names), 0, -1), names, strict=True):
        now_ns = time.monotonic_ns()
        try:
            _meet(client, options, name, plans, now_ns + (until_ns - now_ns) // left)
        except (LinkError, DeviceFault) as problem:
            problems.append(problem)
            refuses = isinstance(problem, DeviceFault) and not options.units[name].identity
            missing |= _tasks(name, plans, writing=False)
            missing |= set() if refuses else _tasks(name, plans, writing=True)
            client.forgive()
    if not problems:
        return
    if all(number in missing for number, plan in enumerate(plans) if plan.outputs):
        raise problems[0]
    raise PartMissing("; ".join(map(str, problems)), missing)


def _meet(client: Client, options: ModbusOptions, name: str, plans: Sequence[TaskPlan], until_ns: int) -> None:
    """Look who one unit is."""
    unit = options.units[name]
    if unit.identity:
        for key, expected in unit.identity.items():
            _compare(client, options, name, unit, key, expected, until_ns)
    elif exchange := _readable(name, unit, plans):
        _ask(client, options, exchange, until_ns)


def _tasks(name: str, plans: Sequence[TaskPlan], *, writing: bool) -> set[int]:
    """Numbers of the tasks of a unit, of those that write or of those that only read."""
    mine = (number for number, plan in enumerate(plans) if plan.name.startswith(f"{name}."))
    return {number for number in mine if bool(plans[number].outputs) == writing}


def single(name: str, unit: Unit, function: int, register: Register, title: str) -> Exchange:
    """A transaction that reads one register of a unit."""
    address = register.address - unit.address_base
    field = Field(name, register, 0, unit.byte_order, unit.word_order)
    return Exchange(unit.unit_id, title, function, Block(address, register.count, (field,)), None)


def _compare(
    client: Client, options: ModbusOptions, name: str, unit: Unit, key: str, expected: Expected, until_ns: int
) -> None:
    register = Register(address=expected.address, type=expected.type)
    title = f"{name} (unit {unit.unit_id}), {key} in register {expected.address}"
    exchange = single(key, unit, expected.function, register, title)
    found = int(exchange.codes(_ask(client, options, exchange, until_ns))[0])
    if found != expected.value:
        raise IdentityMismatch(
            f"{name} (unit {unit.unit_id}) on {options.device} has {key} {found}, the configuration says "
            f"{expected.value}: another device"
        )


def _readable(name: str, unit: Unit, plans: Sequence[TaskPlan]) -> Exchange | None:
    for plan in plans:
        if plan.name.startswith(f"{name}.") and plan.options.read:
            register = next(iter(plan.options.read.values()))
            return single(name, unit, _alone(plan.options), register, f"{name} (unit {unit.unit_id})")
    return None


def _alone(task: Task) -> int:
    """The function that reads alone what a task reads."""
    return 3 if task.function == 23 else task.function


def _ask(client: Client, options: ModbusOptions, exchange: Exchange, until_ns: int) -> bytes:
    """The answer, after a few tries."""
    why: Exception | None = None
    for _ in range(_TRIES):
        try:
            return _answer(client, exchange, until_ns)
        except TransientError as problem:
            why = why or problem
        except LinkError as problem:
            raise LinkError(_advice(options, str(problem))) from problem
    raise LinkError(_advice(options, str(why))) from why


def _advice(options: ModbusOptions, text: str) -> str:
    if options.serial is None:
        return f"{options.device}: {text}"
    s = options.serial
    return (
        f"{options.device}: {text}; is it on, and are baud {s.baud}, parity {s.parity} and unit_id those of the device?"
    )


_ORDERS = ("big", "little")
_PAUSE_S = 0.1
_REGISTERS = {3: "holding registers", 4: "input registers"}
_MOST, _AT_ONCE = 128, 8
"""Registers that are looked at, and those of one request: a device refuses one that goes beyond its last."""


def probe(options: ModbusOptions, client: Client, seconds: float) -> Iterator[Answer]:
    """Ask for all registers, again and again, for so long; nothing is written. Raises LinkError."""
    client.reach()
    end_ns = time.monotonic_ns() + round(seconds * 1e9)
    questions = list(_questions(options))
    for first in itertools.count():
        for unit, name, register, exchange in questions:
            if first and time.monotonic_ns() >= end_ns:
                return
            yield _asked(client, unit, name, register, exchange)
        time.sleep(_PAUSE_S)


def discover(options: ModbusOptions, client: Client, seconds: float) -> Iterator[Answer]:
    """Which units there are, and what their first registers hold; each is asked, none is written to. Raises LinkError.

    Asked until `seconds` are over; those that a network's converters and single devices usually have come first.
    """
    end_ns = time.monotonic_ns() + round(seconds * 1e9)
    with contextlib.closing(client):
        client.reach()
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
    """The registers that come for it. Raises TransientError, DeviceFault, LinkError."""
    return _answer(client, exchange, time.monotonic_ns() + OPEN_NS)[2:]


def _answer(client: Client, exchange: Exchange, until_ns: int) -> bytes:
    """What comes for it, from the function code on. Raises TransientError, DeviceFault, LinkError."""
    client.drain(until_ns)
    answer = None
    if time.monotonic_ns() < until_ns:
        client.ask(exchange, exchange.request({}))
        answer = client.answer(until_ns)
    if answer is None:
        raise TransientError(f"{exchange.title}: no answer")
    return answer.pdu


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
    reading = _alone(task)
    for name, register in task.read.items():
        yield name, register, reading
    for key, own in (("status", task.status), ("counter", task.counter)):
        if own is not None:
            yield f"{task_name}, {key}", own, reading
    for name, output in task.write.items():
        yield name, output, READ_BACK[WRITES[task.function]]
