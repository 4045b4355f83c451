"""The four C functions by which the loop and the host call a bus: its worker does the work."""

from __future__ import annotations

from typing import Any

import numba
from numba import types

from micromanip.rt.bus_image import IMAGE, OUTPUT_STATE, RESTING, SENT_NS, exchange_image
from micromanip.rt.clock import now_ns as clock_ns
from micromanip.rt.clock import sleep_until
from micromanip.rt.intrinsics import CONTEXT_SIGNATURE, EXCHANGE_SIGNATURE, load_acquire
from micromanip.rt.jit import Compiler
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL

compiled = Compiler(__file__)

UNSAFE = 1
"""What ``safe`` returns where the worker did not bring its outputs to rest in time."""
PATIENCE_NS, _STEP_NS = 5_000_000_000, 2_000_000

_POINTER = types.CPointer(numba.from_dtype(IMAGE))
_CONTEXT_FUNCTION = CONTEXT_SIGNATURE.return_type(_POINTER)


@compiled.c_function(
    EXCHANGE_SIGNATURE.return_type(
        _POINTER, types.CPointer(types.float64), types.CPointer(numba.from_dtype(SIGNAL)), types.int64, types.int64
    )
)
def exchange_c(context: Any, outputs: Any, inputs: Any, now_ns: Any, periods: Any) -> Any:
    """Leave the outputs for the worker, take what it has received."""
    image = numba.carray(context, 1)[0]
    return exchange_image(image, numba.carray(outputs, MAX_OUTPUTS), numba.carray(inputs, MAX_SIGNALS), now_ns)


@compiled.c_function(_CONTEXT_FUNCTION)
def safe_c(context: Any) -> Any:
    """Wait until the worker, which has noticed by itself that the loop is dead, has brought its outputs to rest.

    Given up when for a while the device has taken nothing: a worker that died is started anew meanwhile.
    """
    image = numba.carray(context, 1)[0]
    begin = clock_ns(image["timespec"])
    while load_acquire(image["words"], OUTPUT_STATE) != RESTING:
        now = clock_ns(image["timespec"])
        if now - max(begin, load_acquire(image["words"], SENT_NS)) > PATIENCE_NS:
            return UNSAFE
        sleep_until(image["timespec"], now + _STEP_NS)
    return 0


@compiled.c_function(_CONTEXT_FUNCTION)
def open_c(context: Any) -> Any:
    """Nothing to do: the worker has the device."""
    return 0


@compiled.c_function(_CONTEXT_FUNCTION)
def close_c(context: Any) -> Any:
    """Nothing to do: the worker has the device."""
    return 0
