"""A frame on its way through the slave controllers of a line: each acts on each datagram, and counts as it did."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from micromanip.bus.ethercat.registers import (
    APRD,
    APWR,
    ARMW,
    BRD,
    BWR,
    ETHERTYPE,
    FPRD,
    FPWR,
    FRMW,
    LRD,
    LRW,
    STATION,
    TYPE_DATAGRAMS,
)
from micromanip.rt.signatures import array_of

from ..compiled import compiled
from .controller import ESC, map_logical, number, put_number, read, write

NOT_ETHERCAT = -1
"""What ``pass_frame`` returns for a frame that slaves let through untouched."""
_HEADER, _DATAGRAM = 16, 10


@compiled
def pass_datagram(s: Any, data: Any, at: int, length: int, came_ns: int) -> None:
    """Let one controller act on a datagram whose header is at `at`; its frame was at the first one at `came_ns`."""
    now_ns = came_ns + s["to_ns"]
    command, body, wkc_at = int(data[at]), at + _DATAGRAM, at + _DATAGRAM + length
    wkc = 0
    if LRD <= command <= LRW:
        wkc = map_logical(s, command, number(data, at + 2, 4), data, body, length, now_ns)
    elif APRD <= command <= FRMW:
        slave, start = number(data, at + 2, 2), number(data, at + 4, 2)
        if command in (FPRD, FPWR, FRMW):
            here = slave == number(s["memory"], STATION, 2)
        else:
            here = slave == 0 or command in (BRD, BWR)
            put_number(data, at + 2, 2, slave + 1)
        reads = command in (APRD, FPRD, BRD)
        writes = command in (APWR, FPWR, BWR)
        if command in (ARMW, FRMW):
            reads, writes, here = here, not here, True
        if here and writes:
            wkc = write(s, start, data, body, length, now_ns)
        elif here and reads:
            wkc = read(s, start, data, body, length, command == BRD, now_ns)
    s["last_wkc"] = wkc
    put_number(data, wkc_at, 2, number(data, wkc_at, 2) + wkc)


@compiled
def pass_frame(slaves: Any, data: Any, length: int, now_ns: int) -> int:
    """Let a frame pass all controllers up to the first without power: how many datagrams it had, or NOT_ETHERCAT.

    It may pass none: what comes from the far end of a ring goes by behind them, as it is.
    """
    if length < _HEADER or (int(data[12]) << 8 | int(data[13])) != ETHERTYPE:
        return NOT_ETHERCAT
    head = number(data, 14, 2)
    end, at, count, more = min(length, _HEADER + (head & 0x7FF)), _HEADER, 0, 1
    if head >> 12 != TYPE_DATAGRAMS:
        return NOT_ETHERCAT
    while more != 0 and at + _DATAGRAM + 2 <= end:
        size = number(data, at + 6, 2)
        more, size = size >> 15, size & 0x7FF
        if at + _DATAGRAM + size + 2 > end:
            break
        for k in range(len(slaves)):
            if slaves[k]["powered"] == 0:
                break
            pass_datagram(slaves[k], data, at, size, now_ns)
        count += 1
        at += _DATAGRAM + size + 2
    if len(slaves) > 0:
        data[6] |= np.uint8(2)
    return count


@compiled.entry(types.int64(array_of(ESC), types.uint8[::1], types.int64, types.int64))
def passed(slaves: Any, data: Any, length: int, now_ns: int) -> int:
    """``pass_frame`` by itself."""
    return pass_frame(slaves, data, length, now_ns)
