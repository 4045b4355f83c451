"""Who is there: each unit is asked for a register, and for those that say which device it is, before anything moves."""

from __future__ import annotations

import time
from collections.abc import Sequence

from micromanip.driver import BusError, DeviceFault, IdentityMismatch, LinkError, PartMissing, TransientError

from .client import Client
from .codec import Field
from .exchange import Block, Exchange
from .options import Expected, ModbusOptions, Unit
from .plan import TaskPlan
from .task_options import Register

_TRIES = 3
_READ_INSTEAD = {23: 3, 1: 1, 2: 2, 3: 3, 4: 4}
"""Function that reads alone what a function reads."""


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
        function = _READ_INSTEAD.get(plan.options.function)
        if plan.name.startswith(f"{name}.") and function and plan.options.read:
            register = next(iter(plan.options.read.values()))
            return single(name, unit, function, register, f"{name} (unit {unit.unit_id})")
    return None


def _ask(client: Client, options: ModbusOptions, exchange: Exchange, until_ns: int) -> bytes:
    """The answer, after a few tries."""
    why: Exception | None = None
    for _ in range(_TRIES):
        client.drain(until_ns)
        if time.monotonic_ns() >= until_ns:
            break
        try:
            client.ask(exchange, exchange.request({}))
            answer = client.answer(until_ns)
        except TransientError as problem:
            why = problem
        except LinkError as problem:
            raise LinkError(_advice(options, str(problem))) from problem
        else:
            if answer is not None:
                return answer.pdu
    raise LinkError(_advice(options, str(why or f"{exchange.title}: no answer"))) from why


def _advice(options: ModbusOptions, text: str) -> str:
    if options.serial is None:
        return f"{options.device}: {text}"
    s = options.serial
    return (
        f"{options.device}: {text}; is it on, and are baud {s.baud}, parity {s.parity} and unit_id those of the device?"
    )
