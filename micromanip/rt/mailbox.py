"""Shared words: what host and loop tell each other, one int64 each, written by one side only.

Written with ``store_release`` and read with ``load_acquire``: what belongs to a word is in memory before the word
itself. Python's are ``tell`` and ``ask``, good for any words. CPython moves an aligned 8-byte element with one
instruction, and never moves it past another one. What is left is the order that the processor gives the other side to
see. x86-64 shows stores in their order, and loads in theirs: nothing is needed. Any other one gets a fence of
libatomic. The host and the workers of the buses need not load a compiler for it.
"""

from __future__ import annotations

import ctypes
import platform
from collections.abc import Callable
from typing import Any

from micromanip.errors import ConfigError

HEARTBEAT_NS, COMMAND, COMMAND_NUMBER, SLOT, VERSION, SNAPSHOT_NUMBER, CANDIDATE, CANDIDATE_NUMBER = range(8)
"""Written by the host: time of its last sign of life; the command and its running number; the
parameter slot and its version; the running number of the last snapshot wanted; the slot of the candidate tuning and
its running number, 0 before there is one."""

(
    CYCLE,
    STATE,
    FAULT_CODE,
    COMMAND_DONE,
    COMMAND_ACCEPTED,
    VERSION_ACTIVE,
    SNAPSHOT_DONE,
    OVERRUNS,
    LATENESS_MAX_NS,
    COMPUTE_MAX_NS,
    RIGHTS,
    FINISHED,
    CYCLES_RUN,
    TRIPS,
    SHADOW,
) = range(15)
"""Written by the loop: its cycle, state and fault; number and outcome of the last command; the
parameter version in force; the last snapshot made; counters and maxima; which real-time rights it
could not get; 1 when it has ended by itself; cycles really run; faults latched so far; where
the candidate tuning stands."""

NO_FIFO, NO_LOCK, NO_PIN = 1, 2, 4
"""Bits of RIGHTS."""

WORDS = 64
RING_HEAD = 0
"""The one word of the telemetry ring: rows written since the start."""

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
