"""Atomic words, calls by address and of the system, its clock: the few operations numba has no notation for.

Plain loads from shared memory are hoisted out of loops by the compiler; whatever another process
writes is read with ``load_acquire`` and published with ``store_release``. With the JIT disabled
the same names are plain Python, good for tests in one process.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .jit import compiled

EXCHANGE_SIGNATURE = types.int32(types.intp, types.intp, types.intp, types.int64, types.int64)
"""int32_t exchange(void *context, double *outputs, struct mm_signal *inputs, int64_t now_ns, int64_t periods)"""
CONTEXT_SIGNATURE = types.int32(types.intp)
"""int32_t open(void *context), likewise safe and close"""

_EXCHANGE_C = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64
)


_MONOTONIC, _REALTIME, _ABSOLUTE = 1, 0, 1
_SECOND_NS = 1_000_000_000


def system_call(name: str, result: Any, *arguments: Any) -> Any:
    """A function of the C library by numba's types, an address being an ``intp``; its errno is ``last_error``."""
    if not numba.config.DISABLE_JIT:
        return types.ExternalFunction(name, result(*arguments))
    function = ctypes.CDLL(None, use_errno=True)[name]
    function.restype, *function.argtypes = [getattr(ctypes, f"c_{kind}") for kind in (result, *arguments)]
    return function


if numba.config.DISABLE_JIT:
    last_error = ctypes.get_errno

    def load_acquire(words: Any, index: int) -> int:
        """Element of an int64 array, read before everything that follows."""
        return int(words[index])

    def store_release(words: Any, index: int, value: int) -> None:
        """Write an element of an int64 array after everything that came before."""
        words[index] = value

    def fence() -> None:
        """Nothing that was read or written before is moved behind this point, and nothing after it before."""

    def call_exchange(function: int, context: int, outputs: int, inputs: int, now_ns: int, periods: int) -> int:
        """Call a driver's exchange by its address; its return code."""
        return int(_EXCHANGE_C(int(function))(int(context), int(outputs), int(inputs), int(now_ns), int(periods)))

else:

    @intrinsic
    def last_error(typingctx: Any) -> Any:
        """errno, as the system call before has left it."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            number = ir.IntType(32)
            kind = ir.FunctionType(number.as_pointer(), [])
            place = cgutils.get_or_insert_function(builder.module, kind, "__errno_location")
            return builder.load(builder.call(place, []))

        return types.int32(), codegen

    @intrinsic
    def load_acquire(typingctx: Any, words: Any, index: Any) -> Any:
        """Element of an int64 array, read before everything that follows."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            pointer = _element(context, builder, signature.args[0], args[0], args[1])
            return builder.load_atomic(pointer, "acquire", 8)

        return types.int64(words, types.int64), codegen

    @intrinsic
    def store_release(typingctx: Any, words: Any, index: Any, value: Any) -> Any:
        """Write an element of an int64 array after everything that came before."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            pointer = _element(context, builder, signature.args[0], args[0], args[1])
            builder.store_atomic(args[2], pointer, "release", 8)
            return context.get_dummy_value()

        return types.void(words, types.int64, types.int64), codegen

    @intrinsic
    def fence(typingctx: Any) -> Any:
        """Nothing that was read or written before is moved behind this point, and nothing after it before."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            builder.fence("acq_rel")
            return context.get_dummy_value()

        return types.void(), codegen

    def _element(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
        view = cgutils.create_struct_proxy(array_type)(context, builder, array)
        return builder.gep(view.data, [index])

    @intrinsic
    def call_exchange(
        typingctx: Any, function: Any, context_address: Any, outputs: Any, inputs: Any, now_ns: Any, periods: Any
    ) -> Any:
        """Call a driver's exchange by its address; its return code."""
        signature = types.int32(types.int64, types.int64, types.int64, types.int64, types.int64, types.int64)

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            word = ir.IntType(64)
            prototype = ir.FunctionType(ir.IntType(32), [word] * 5)
            return builder.call(builder.inttoptr(args[0], prototype.as_pointer()), args[1:])

        return signature, codegen


_clock_gettime = system_call("clock_gettime", types.int32, types.int32, types.intp)
_clock_nanosleep = system_call("clock_nanosleep", types.int32, types.int32, types.int32, types.intp, types.intp)


@compiled
def clock_ns(clock: int, timespec: Any) -> int:
    """Nanoseconds of a clock of the system; `timespec` is scratch, int64 (2,)."""
    _clock_gettime(clock, timespec.ctypes.data)
    return timespec[0] * _SECOND_NS + timespec[1]


@compiled
def now_ns(timespec: Any) -> int:
    """Nanoseconds of CLOCK_MONOTONIC."""
    return clock_ns(_MONOTONIC, timespec)


@compiled
def wall_ns(timespec: Any) -> int:
    """Nanoseconds of CLOCK_REALTIME, which may be stepped."""
    return clock_ns(_REALTIME, timespec)


@compiled
def sleep_until(timespec: Any, wake_ns: int) -> None:
    """Sleep to the absolute time `wake_ns`; returns early only at a signal."""
    timespec[0], timespec[1] = wake_ns // _SECOND_NS, wake_ns % _SECOND_NS
    _clock_nanosleep(_MONOTONIC, _ABSOLUTE, timespec.ctypes.data, 0)


@compiled
def wait_until(timespec: Any, deadline_ns: int, spin_ns: int) -> int:
    """Sleep to `spin_ns` before `deadline_ns`, spin the rest; returns the time it then is.

    The kernel's wake-up is tens of microseconds late; the spin absorbs that, at the price of a CPU
    that is busy for that share of the period.
    """
    now = now_ns(timespec)
    if deadline_ns - now > spin_ns:
        sleep_until(timespec, deadline_ns - spin_ns)
        now = now_ns(timespec)
    while now < deadline_ns:
        now = now_ns(timespec)
    return now
