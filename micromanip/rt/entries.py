"""The C functions of a driver that numba compiles, made of functions that take the records themselves."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba import types

from .intrinsics import CONTEXT_SIGNATURE, EXCHANGE_SIGNATURE
from .io.worker_records import INBOX
from .jit import CFunction, Compiler
from .records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL


class Entries(tuple[CFunction, ...]):
    """In the order of ``micromanip.driver.Functions``, or as ``Steady`` has them."""

    __slots__ = ()

    @property
    def addresses(self) -> tuple[int, ...]:
        """In this process; what is not in the cache is compiled."""
        return tuple(function.address for function in self)


def _pointer(to: Any) -> Any:
    return types.CPointer(numba.from_dtype(np.dtype(to)))


def _signature(context: np.dtype[np.void], inputs: np.dtype[np.void]) -> Any:
    pointers = _pointer(context), _pointer(float), _pointer(inputs)
    return EXCHANGE_SIGNATURE.return_type(*pointers, types.int64, types.int64)


def entries(compiled: Compiler, context: np.dtype[np.void], begin: Any, exchange: Any, rest: Any, end: Any) -> Entries:
    """Entries of a driver with a `context`: open, exchange, safe and close call these, compiled functions of a module.

    ``exchange(context, outputs, inputs, now_ns, periods)`` and the others, of the context alone, return the code.
    """

    def exchange_c(at: Any, outputs: Any, inputs: Any, now_ns: Any, periods: Any) -> Any:
        left, came = numba.carray(outputs, MAX_OUTPUTS), numba.carray(inputs, MAX_SIGNALS)
        return exchange(numba.carray(at, 1)[0], left, came, now_ns, periods)

    def of_context(name: str, function: Any) -> CFunction:
        def entry(at: Any) -> Any:
            return function(numba.carray(at, 1)[0])

        entry.__name__ = entry.__qualname__ = name  # by which the cache knows it
        return compiled.c_function(CONTEXT_SIGNATURE.return_type(_pointer(context)))(entry)

    exchange_entry = compiled.c_function(_signature(context, SIGNAL))(exchange_c)
    return Entries(
        (of_context("open_c", begin), exchange_entry, of_context("safe_c", rest), of_context("close_c", end))
    )


def steady_entries(compiled: Compiler, context: np.dtype[np.void], take: Any, give: Any) -> Entries:
    """Entries of a driver with a `context`; they call these, compiled functions of a module.

    ``take(context, inbox, began_ns)`` and ``give(context, values, task)`` return what ``worker_loop.py`` says.
    """
    signature = _signature(context, INBOX)

    def receive_c(at: Any, values: Any, inbox: Any, began_ns: Any, task: Any) -> Any:  # noqa: ARG001
        return take(numba.carray(at, 1)[0], numba.carray(inbox, 1)[0], began_ns)

    def send_c(at: Any, values: Any, inbox: Any, now_ns: Any, task: Any) -> Any:  # noqa: ARG001
        return give(numba.carray(at, 1)[0], numba.carray(values, MAX_OUTPUTS), task)

    return Entries((compiled.c_function(signature)(receive_c), compiled.c_function(signature)(send_c)))
