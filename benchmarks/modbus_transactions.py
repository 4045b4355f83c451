"""Transactions a second of the driver `modbus` beside the bare library's client: function 23, as in config/modbus.yaml.

Both ask the same unit, in turns. The driver's include what a worker gets of them: samples with scale and time.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pymodbus.client import ModbusTcpClient

from micromanip.bus.driver import BusDriver
from micromanip.bus.inbox import Inbox
from micromanip.bus.registry import driver_class
from micromanip.errors import CheckFailed

from .modbus_unit import REGISTERS_READ, REGISTERS_WRITTEN
from .plan import Plan
from .results import Result

TRANSACTIONS = 2000
_PATIENCE_NS = 1_000_000_000
_WRITTEN_AT = 100
_UNIT = 1


def run(plan: Plan) -> list[Result]:
    """Transactions a second, the best of the pairs of each."""
    with _unit() as port:
        driver = _driver(port)
        pairs = []
        for pair in range(plan.pairs):
            plan.tell(f"modbus_transactions: pair {pair + 1} of {plan.pairs}")
            pairs.append((_rate_hz(lambda: _taken(driver)), _rate_hz(lambda: _asked(port))))
    ours, bare = (max(rates) for rates in zip(*pairs, strict=True))
    return [Result.of("modbus_transactions", ours, "transactions/s", "pymodbus alone", bare)]


def _rate_hz(ask: Callable[[], None]) -> float:
    begin = time.perf_counter()
    ask()
    return TRANSACTIONS / (time.perf_counter() - begin)


def _asked(port: int) -> None:
    with ModbusTcpClient("127.0.0.1", port=port, timeout=1, retries=0) as client:
        for _ in range(TRANSACTIONS):
            answer = client.readwrite_registers(
                read_address=0,
                read_count=REGISTERS_READ,
                write_address=_WRITTEN_AT,
                values=[0] * REGISTERS_WRITTEN,
                device_id=_UNIT,
            )
            if len(answer.registers) != REGISTERS_READ:
                raise CheckFailed("the library got no answer")


def _taken(driver: BusDriver) -> None:
    """As the worker does it."""
    inbox, values = Inbox(), [0.0] * len(driver.outputs)
    driver.open()
    try:
        for _ in range(TRANSACTIONS):
            driver.perform(0, values, inbox)
            driver.receive(inbox, time.monotonic_ns() + _PATIENCE_NS)
            if len(inbox) != len(driver.inputs):
                raise CheckFailed("the driver got no answer")
            inbox.clear()
    finally:
        driver.close()


def _driver(port: int) -> BusDriver:
    kind = driver_class("modbus")
    assert issubclass(kind, BusDriver)
    read = {f"r{i}": {"address": i, "type": "int16", "scale": 0.01} for i in range(REGISTERS_READ)}
    write = {
        f"w{i}": {"address": _WRITTEN_AT + i, "type": "int16", "scale": 0.005, "cyclic_safe": True}
        for i in range(REGISTERS_WRITTEN)
    }
    task = {"function": 23, "rate_hz": 500.0, "read": read, "write": write}
    unit = {"unit_id": _UNIT, "address_base": 0, "byte_order": "big", "word_order": "big", "tasks": {"all": task}}
    options = {"tcp": {"host": "127.0.0.1", "port": port}, "timeout_ms": 50, "response_ms": 1, "units": {"unit": unit}}
    return kind(kind.Options.model_validate(options), Path())


@contextmanager
def _unit() -> Iterator[int]:
    command = [sys.executable, "-m", "benchmarks.modbus_unit"]
    root = Path(__file__).parent.parent
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=root) as process:
        assert process.stdout is not None
        try:
            yield int(process.stdout.readline())
        finally:
            process.kill()
