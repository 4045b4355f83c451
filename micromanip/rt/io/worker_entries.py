"""The two C functions of a bus driver that numba compiles, made of functions that take the records themselves."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types

from micromanip.rt.intrinsics import EXCHANGE_SIGNATURE
from micromanip.rt.jit import CFunction, Compiler
from micromanip.rt.records import MAX_OUTPUTS

from .worker_records import INBOX


class SteadyEntries(NamedTuple):
    """What ``Steady`` has the addresses of."""

    receive: CFunction
    send: CFunction

    @property
    def addresses(self) -> tuple[int, int]:
        """In this process; what is not in the cache is compiled."""
        return self.receive.address, self.send.address


def steady_entries(compiled: Compiler, context: np.dtype[np.void], take: Any, give: Any) -> SteadyEntries:
    """Entries of a driver with a `context`; they call these, compiled functions of a module.

    ``take(context, inbox, began_ns)`` and ``give(context, values, task)`` return what ``worker_loop.py`` says.
    """
    signature = EXCHANGE_SIGNATURE.return_type(
        types.CPointer(numba.from_dtype(context)),
        types.CPointer(types.float64),
        types.CPointer(numba.from_dtype(INBOX)),
        types.int64,
        types.int64,
    )

    def receive_c(at: Any, values: Any, inbox: Any, began_ns: Any, task: Any) -> Any:  # noqa: ARG001
        return take(numba.carray(at, 1)[0], numba.carray(inbox, 1)[0], began_ns)

    def send_c(at: Any, values: Any, inbox: Any, now_ns: Any, task: Any) -> Any:  # noqa: ARG001
        return give(numba.carray(at, 1)[0], numba.carray(values, MAX_OUTPUTS), task)

    return SteadyEntries(compiled.c_function(signature)(receive_c), compiled.c_function(signature)(send_c))
