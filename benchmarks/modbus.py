"""Transactions a second of the driver `modbus` beside the bare library's client: function 23, as in config/modbus.yaml.

Both ask the same unit, in turns. The driver's include what a worker gets of them: samples with scale and time.
"""

from __future__ import annotations

import time

from pymodbus.client import ModbusTcpClient

from micromanip.bus.driver import BusDriver
from micromanip.errors import CheckFailed

from .exchange import best, driver_of, partner, perform
from .partners import REGISTERS_READ, REGISTERS_WRITTEN
from .runner import Plan, Result

TRANSACTIONS = 2000
_WRITTEN_AT, _UNIT = 100, 1


def run(plan: Plan) -> list[Result]:
    """The best of the pairs of each."""
    with partner("modbus") as port:
        driver = _driver(int(port))
        plays = (lambda: perform(driver, TRANSACTIONS), lambda: _ask(int(port)))
        ours, bare = best(plan, "modbus", TRANSACTIONS, plays, time.perf_counter)
    return [Result.of("modbus_transactions", ours, "transactions/s", "pymodbus alone", bare)]


def _ask(port: int) -> None:
    values = [0] * REGISTERS_WRITTEN
    with ModbusTcpClient("127.0.0.1", port=port, timeout=1, retries=0) as client:
        for _ in range(TRANSACTIONS):
            answer = client.readwrite_registers(
                read_address=0, read_count=REGISTERS_READ, write_address=_WRITTEN_AT, values=values, device_id=_UNIT
            )
            if len(answer.registers) != REGISTERS_READ:
                raise CheckFailed("the library got no answer")


def _driver(port: int) -> BusDriver:
    read = {f"r{i}": {"address": i, "type": "int16", "scale": 0.01} for i in range(REGISTERS_READ)}
    write = {
        f"w{i}": {"address": _WRITTEN_AT + i, "type": "int16", "scale": 0.005, "cyclic_safe": True}
        for i in range(REGISTERS_WRITTEN)
    }
    task = {"function": 23, "rate_hz": 500.0, "read": read, "write": write}
    unit = {"unit_id": _UNIT, "address_base": 0, "byte_order": "big", "word_order": "big", "tasks": {"all": task}}
    tcp = {"host": "127.0.0.1", "port": port}
    return driver_of("modbus", {"tcp": tcp, "timeout_ms": 50, "response_ms": 1, "units": {"unit": unit}})
