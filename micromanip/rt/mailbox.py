"""The segments of shared memory, and their words between host and loop, each written by one side only.

A word is an int64, written with ``store_release`` and read with ``load_acquire``: its payload is in memory before the
word. Python uses ``tell`` and ``ask``. CPython moves an aligned 8-byte element with one instruction, and never reorders
two. So only the processor's memory order matters. x86-64 keeps the order of stores and of loads: nothing is needed. Any
other processor gets a fence of libatomic. Host and bus workers need no compiler for this.
"""

from __future__ import annotations

import ctypes
import math
import platform
from collections.abc import Callable
from typing import Any

from micromanip.errors import ConfigError

from .jit import compiled
from .record import record
from .records import CELL_PARAMETERS, CELL_STATE, MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from .telemetry import ROW

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

SPLIT = 32
BINS = SPLIT * 60
_SPLIT_BITS = 5
"""Of a histogram of durations (ns) with bounded relative error: each power of two is split into equal bins, so that a
percentile is good to 3 %; below 32 ns the bins are 1 ns."""

WORDS = 64
RING_HEAD = 0
"""The one word of the telemetry ring: rows written since the start."""

RING_ROWS = 1 << 16
"""At 20 kHz 3.3 s: the black box of a trip needs 2.5 s, and time to fetch them."""

SLOTS = 64
"""Two would do for the loop; the recorder finds the sets of a burst of swaps here."""

CONTROL = record(("words", "i8", (WORDS,)), ("parameters", CELL_PARAMETERS, (SLOTS,)))
"""Written by the host only."""
STATUS = record(
    ("words", "i8", (WORDS,)),
    ("state", CELL_STATE, (1,)),
    ("shadow", CELL_STATE, (1,)),
    ("snapshot", CELL_STATE, (1,)),
    ("lateness", "i8", (BINS,)),
    ("compute", "i8", (BINS,)),
    ("timespec", "i8", (2,)),
    ("signals", SIGNAL, (MAX_SIGNALS,)),
    ("outputs", "f8", (MAX_OUTPUTS,)),
)
"""Written by the loop only."""
RING = record(("words", "i8", (WORDS,)), ("rows", ROW, (RING_ROWS,)))
"""Telemetry, written by the loop only; any number of readers, none of which the loop waits for."""

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


@compiled
def bin_of(value: int) -> int:
    """Bin of a duration (ns); negative ones count as 0."""
    if value < SPLIT:
        return max(0, value)
    exponent = math.frexp(float(value))[1] - 1
    shift = exponent - _SPLIT_BITS
    return min(BINS - 1, (shift + 1) * SPLIT + (value >> shift) - SPLIT)


@compiled
def lower_edge(index: int) -> int:
    """Smallest duration (ns) that falls into bin `index`."""
    if index < SPLIT:
        return index
    shift = index // SPLIT - 1
    return (SPLIT + index % SPLIT) << shift


@compiled
def count(histogram: Any, value: int) -> None:
    """Add one duration (ns)."""
    histogram[bin_of(value)] += 1
