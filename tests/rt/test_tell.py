"""The host's words: written and read whole, and in order on every CPU."""

import ctypes

import numpy as np
import pytest

from micromanip.errors import ConfigError
from micromanip.rt import mailbox as module
from micromanip.rt.mailbox import WORDS, ask, tell


def test_a_word_is_written_and_read():
    words = np.zeros(WORDS, np.int64)
    tell(words, 3, -7)
    assert words.tolist() == [0, 0, 0, -7] + [0] * (WORDS - 4)
    assert ask(words, 3) == -7


def test_a_weakly_ordered_cpu_gets_a_fence(monkeypatch):
    """Before a word is written, and after one was read."""
    done = []

    class Library:
        def __init__(self, name):
            assert name == "libatomic.so.1"

        def atomic_thread_fence(self, order):
            done.append((order, words[0]))

    words = np.zeros(1, np.int64)
    monkeypatch.setattr(ctypes, "CDLL", Library)
    monkeypatch.setattr(module, "fence", module._fence_of("aarch64"))
    tell(words, 0, 5)
    assert done == [(5, 0)]
    assert ask(words, 0) == 5
    assert done == [(5, 0), (5, 5)]


def test_without_the_fence_nothing_starts(monkeypatch):
    def missing(name):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(ctypes, "CDLL", missing)
    with pytest.raises(ConfigError, match=r"a processor aarch64 needs .* package libatomic1"):
        module._fence_of("aarch64")
