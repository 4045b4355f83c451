"""Shared words as Python reads and writes them: what a word announces is in memory before the word, on every CPU.

CPython moves an aligned 8-byte element with one instruction, and never moves it past another one. What is left is the
order that the processor gives the other side to see. x86-64 shows stores in their order, and loads in theirs: nothing
is needed. Any other one gets a fence of libatomic. No compiled code takes part: the host and the workers of the buses
need not load a compiler for it.
"""

from __future__ import annotations

import ctypes
import platform
from collections.abc import Callable
from typing import Any

from micromanip.errors import ConfigError

_SEQUENTIALLY_CONSISTENT = 5
"""As in C's <stdatomic.h>."""


def _fence_of(machine: str) -> Callable[[], object]:
    if machine in ("x86_64", "AMD64"):
        return lambda: None
    try:
        thread_fence = ctypes.CDLL("libatomic.so.1").atomic_thread_fence
    except (OSError, AttributeError) as problem:
        raise ConfigError(f"a processor {machine} needs libatomic.so.1, package libatomic1: {problem}") from problem
    return lambda: thread_fence(_SEQUENTIALLY_CONSISTENT)


fence = _fence_of(platform.machine())
"""Nothing that was read or written before is moved behind this point, and nothing after it before."""


def tell(words: Any, word: int, value: int) -> None:
    """Write a word after everything that was written before."""
    fence()
    words[word] = value


def ask(words: Any, word: int) -> int:
    """Read a word before everything that is read after."""
    value = int(words[word])
    fence()
    return value
