"""The host's way to the shared words: what a word announces is in memory before the word, on every kind of CPU."""

from __future__ import annotations

from typing import Any

from numba import types

from .intrinsics import load_acquire, store_release
from .jit import compiled
from .signatures import WORDS


@compiled.entry(types.void(WORDS, types.int64, types.int64))
def tell(words: Any, word: int, value: int) -> None:
    """Write a word after everything that was written before."""
    store_release(words, word, value)


@compiled.entry(types.int64(WORDS, types.int64))
def ask(words: Any, word: int) -> int:
    """Read a word before everything that is read after."""
    return load_acquire(words, word)
