"""Shared words: what host and loop tell each other, one int64 each, written by one side only.

Written with ``store_release`` and read with ``load_acquire``: what belongs to a word is in memory
before the word itself.
"""

from __future__ import annotations

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
