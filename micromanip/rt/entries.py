"""The four C functions of a driver that numba compiles, made of functions that take the records themselves."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types

from .intrinsics import CONTEXT_SIGNATURE, EXCHANGE_SIGNATURE
from .jit import CFunction, Compiler
from .records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL


class Entries(NamedTuple):
    """In the order of ``micromanip.driver.Functions``."""

    open: CFunction
    exchange: CFunction
    safe: CFunction
    close: CFunction

    @property
    def addresses(self) -> tuple[int, int, int, int]:
        """In this process; what is not in the cache is compiled."""
        return self.open.address, self.exchange.address, self.safe.address, self.close.address


def entries(compiled: Compiler, context: np.dtype[np.void], begin: Any, exchange: Any, rest: Any, end: Any) -> Entries:
    """Entries of a driver with a `context`: open, exchange, safe and close call these, compiled functions of a module.

    ``exchange(context, outputs, inputs, now_ns, periods)`` and the others, of the context alone, return the code.
    """
    pointer = types.CPointer(numba.from_dtype(context))
    exchange_signature = EXCHANGE_SIGNATURE.return_type(
        pointer, types.CPointer(types.float64), types.CPointer(numba.from_dtype(SIGNAL)), types.int64, types.int64
    )

    def exchange_c(at: Any, outputs: Any, inputs: Any, now_ns: Any, periods: Any) -> Any:
        return exchange(
            numba.carray(at, 1)[0],
            numba.carray(outputs, MAX_OUTPUTS),
            numba.carray(inputs, MAX_SIGNALS),
            now_ns,
            periods,
        )

    def of_context(name: str, function: Any) -> CFunction:
        def entry(at: Any) -> Any:
            return function(numba.carray(at, 1)[0])

        entry.__name__ = entry.__qualname__ = name  # by which the cache knows it
        return compiled.c_function(CONTEXT_SIGNATURE.return_type(pointer))(entry)

    return Entries(
        of_context("open_c", begin),
        compiled.c_function(exchange_signature)(exchange_c),
        of_context("safe_c", rest),
        of_context("close_c", end),
    )
