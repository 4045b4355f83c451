"""The C functions by which the loop calls a bus: its worker does the work."""

from __future__ import annotations

from typing import Any

from micromanip.rt.bus_exchange import exchange_image
from micromanip.rt.bus_image import IMAGE
from micromanip.rt.entries import entries
from micromanip.rt.jit import Compiler

compiled = Compiler(__file__)


@compiled
def exchange(image: Any, outputs: Any, inputs: Any, now_ns: int, periods: int) -> int:
    """Leave the outputs for the worker, take what it has received."""
    return exchange_image(image, outputs, inputs, now_ns)


@compiled
def nothing(image: Any) -> int:
    """The worker has the device."""
    return 0


@compiled
def unsafe(image: Any) -> int:
    """Nor can anybody else bring it to rest: the host waits until the worker has done it."""
    return 1


ENTRIES = entries(compiled, IMAGE, nothing, exchange, unsafe, nothing)
