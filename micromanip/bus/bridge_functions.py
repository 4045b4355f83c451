"""The C functions by which the loop calls a bus: its worker does the work."""

from __future__ import annotations

from typing import Any

import numba
from numba import types

from micromanip.rt.bus_exchange import exchange_image
from micromanip.rt.bus_image import IMAGE
from micromanip.rt.intrinsics import CONTEXT_SIGNATURE, EXCHANGE_SIGNATURE
from micromanip.rt.jit import Compiler
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL

compiled = Compiler(__file__)

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
def open_c(context: Any) -> Any:
    """Nothing to do: the worker has the device."""
    return 0


@compiled.c_function(_CONTEXT_FUNCTION)
def close_c(context: Any) -> Any:
    """Nothing to do: the worker has the device."""
    return 0
