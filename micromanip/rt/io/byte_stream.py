"""Bytes of a terminal or a TCP connection without Python: the system calls of a descriptor that does not block."""

from __future__ import annotations

import ctypes
from typing import Any

import numba
from numba import types

from micromanip.rt.jit import compiled

if numba.config.DISABLE_JIT:
    _libc = ctypes.CDLL(None, use_errno=True)

    def _read(descriptor: int, place: int, most: int) -> int:
        return int(_libc.read(int(descriptor), ctypes.c_void_p(int(place)), ctypes.c_size_t(int(most))))

    def _write(descriptor: int, place: int, count: int) -> int:
        return int(_libc.write(int(descriptor), ctypes.c_void_p(int(place)), ctypes.c_size_t(int(count))))

    def _pwrite(descriptor: int, place: int, count: int, at: int) -> int:
        where = ctypes.c_void_p(int(place)), ctypes.c_size_t(int(count)), ctypes.c_int64(int(at))
        return int(_libc.pwrite(int(descriptor), *where))

    def _ioctl(descriptor: int, request: int, place: int) -> int:
        return int(_libc.ioctl(int(descriptor), ctypes.c_ulong(int(request)), ctypes.c_void_p(int(place))))

    def _errno() -> int:
        return ctypes.get_errno()

else:
    from micromanip.rt.intrinsics import last_error as _errno

    _read = types.ExternalFunction("read", types.int64(types.int32, types.intp, types.uint64))
    _write = types.ExternalFunction("write", types.int64(types.int32, types.intp, types.uint64))
    _pwrite = types.ExternalFunction("pwrite", types.int64(types.int32, types.intp, types.uint64, types.int64))
    _ioctl = types.ExternalFunction("ioctl", types.int32(types.int32, types.uint64, types.intp))


@compiled
def read_bytes(descriptor: int, place: int, most: int) -> int:
    """What is there, at most so many bytes, to an address: how many, 0 where the other end is gone, minus an error
    number.
    """
    count = _read(descriptor, place, most)
    return count if count >= 0 else -_errno()


@compiled
def write_bytes(descriptor: int, place: int, count: int) -> int:
    """Hand over so many bytes from an address: how many the system took, or minus an error number."""
    taken = _write(descriptor, place, count)
    return taken if taken >= 0 else -_errno()


@compiled
def write_at(descriptor: int, words: Any, at: int) -> int:
    """Write `words` of 8 bytes into a file, from `at` on: 0, or minus an error number."""
    return 0 if _pwrite(descriptor, words.ctypes.data, 8 * len(words), at) >= 0 else -_errno()


@compiled
def ask(descriptor: int, request: int, place: int) -> int:
    """An ``ioctl`` that answers with a number (int32) at an address: 0, or minus an error number."""
    return 0 if _ioctl(descriptor, request, place) >= 0 else -_errno()
