"""What the registers that are written have now: where the outputs stand when the line is opened."""

from __future__ import annotations

from collections.abc import Sequence

from micromanip.driver import DeviceFault, TransientError

from .client import Client
from .exchange import Exchange
from .plan import TaskPlan

_READ_COILS, _READ_HOLDING_REGISTERS = 1, 3
_WRITES_COILS = (5, 15)


def read_back(client: Client, plans: Sequence[TaskPlan], until_ns: int) -> dict[str, float]:
    """Values by the outputs' names, without those that a unit does not tell: it may let them be written only.

    Each transaction is tried once: nothing says that a unit which refuses in silence is worth waiting for. Raises
    LinkError.
    """
    found: dict[str, float] = {}
    for exchange in (exchange for plan in plans for exchange in plan.exchanges):
        if exchange.written is None:
            continue
        function = _READ_COILS if exchange.function in _WRITES_COILS else _READ_HOLDING_REGISTERS
        asking = Exchange(exchange.unit_id, f"{exchange.title}, read back", function, exchange.written, None)
        client.drain(until_ns)
        try:
            client.ask(asking, asking.request({}))
            answer = client.answer(until_ns)
        except (TransientError, DeviceFault):
            continue
        if answer is not None:
            found.update(zip(asking.inputs, asking.values(answer.pdu), strict=True))
    client.drain(until_ns)
    return found
