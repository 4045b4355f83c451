"""The test bus and its CAN devices in compiled code, as long as nothing happens that Python has to judge.

It stands in for ``testbus/wire.py`` and ``canbus.CanDevice`` while every controller is error-active, no queue is full
and nothing is injected. Bus time goes on as it does there: all that happened up to now is worked off in its order, at
the times at which it happened. So it need not wake when a sample is due or a command comes, only when a frame of the
devices ends, which somebody waits for. Anything else goes back to Python (``steady_buses.py``), with nothing done by
halves: a frame out of the ordinary, a client that does not read, a machine that came too late.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types

from micromanip.rt.clock import now_ns
from micromanip.rt.records import SIGNAL
from micromanip.rt.signatures import array_of
from micromanip.rt.wire.codec import bits_at, put_bits
from micromanip.rt.wire.datagrams import length_of, receive, send, wait_for_any
from micromanip.rt.wire.records import BATCH

from ..arrivals import note
from ..compiled import compiled
from ..compiled_plant import advance
from ..path_error import PATH_ERRORS, note_errors
from .frames import FIRST, ONE, PACKET_BYTES, STAMP_BYTES, put_code, put_nearest, value_at
from .records import BUS, FAR_NS, MAX_CLIENTS, NOBODY, ODD, SERVED

LATEST_NS = 5_000_000
"""What is worked off later than this is Python's."""
_CLASSIC_PACKET = 24
_SWITCHES, _EXTENDED, _NOT_PLAIN = 1, 0x80000000, 0x60000000
_RESTED_NS = 20_000
_LOOK_NS = 1_000_000
"""It waits no longer: commands that nobody else waits for are taken."""

_ARRAYS = (array_of(SERVED), array_of(BUS), types.float64[::1], array_of(SIGNAL), array_of(PATH_ERRORS))


@compiled.entry(types.int64(*_ARRAYS, types.int32[:, ::1], types.int64))
def serve(served: Any, buses: Any, outputs: Any, signals: Any, errors: Any, poll: Any, until_ns: int) -> int:
    """Serve until then, or until one of Python's descriptors has something; 0, or ODD.

    `outputs`, `signals` and `errors` are the plant's, `poll` (n, 2) one ``struct pollfd`` for each descriptor.
    """
    d = served[0]
    while True:
        now = now_ns(d["timespec"])
        next_ns = work_off(d, buses, outputs, signals, errors, now)
        if next_ns == ODD:
            return ODD
        if now >= until_ns:
            return 0
        before_ns = now_ns(d["timespec"])
        for_ns = min(min(next_ns, until_ns) - before_ns, _LOOK_NS)
        ready = wait_for_any(poll, len(poll), for_ns, d["timespec"])
        after_ns = now_ns(d["timespec"])
        if after_ns - before_ns > _RESTED_NS:
            d["rested_ns"] = after_ns
        if ready < 0 or needs_python(d, poll):
            work_off(d, buses, outputs, signals, errors, after_ns)
            return 0


@compiled.entry(types.int64(*_ARRAYS, types.int64))
def catch_up(served: Any, buses: Any, outputs: Any, signals: Any, errors: Any, now: int) -> int:
    """Work off what has happened until `now`: when there is something to do next, or ODD."""
    return work_off(served[0], buses, outputs, signals, errors, now)


@compiled
def needs_python(d: Any, poll: Any) -> bool:
    """Whether something has come on one of Python's descriptors."""
    found = 0
    for i in range(d["descriptors"]):
        found |= poll[i, 1] >> 16  # the field revents
    return found != 0


@compiled.rare
def work_off(d: Any, buses: Any, outputs: Any, signals: Any, errors: Any, now: int) -> int:
    """What has happened until `now`, on all buses in its order; when somebody waits for the next, or ODD."""
    for b in range(d["buses"]):
        if not listen(buses[b], now):
            return ODD
    while True:
        at_ns, first = FAR_NS, 0
        for b in range(d["buses"]):
            next_ns = next_event(buses[b])
            if next_ns < at_ns:
                at_ns, first = next_ns, b
        if at_ns > now:
            break
        if now - at_ns > LATEST_NS or not let_happen(d, buses[first], outputs, signals, errors, at_ns, now):
            return ODD
    next_ns = FAR_NS
    for b in range(d["buses"]):
        next_ns = min(next_ns, next_delivery(buses[b]))
    return next_ns


@compiled
def listen(h: Any, now: int) -> bool:
    """Take what clients have sent; False where one is gone, or says what is out of the ordinary."""
    for i in range(h["clients"]):
        c = h["client"][i]
        if c["next"] < c["waiting"]:
            continue
        count = receive(c["socket"])
        c["next"], c["waiting"], c["heard_ns"] = 0, max(0, count), now
        for k in range(count):
            if length_of(c["socket"], k) == 0:
                c["waiting"] = k
                return False
        if count < 0 or (count > 0 and not is_plain(h, c)):
            return False
    return True


@compiled
def is_plain(h: Any, c: Any) -> bool:
    """Whether the next packet of a client is a frame of data that this bus carries."""
    s, k = c["socket"], c["next"]
    data, length = s["received"][k], length_of(s, k)
    if length != _CLASSIC_PACKET and (length != PACKET_BYTES or h["fd"] == 0):
        return False
    return word_of(data) & _NOT_PLAIN == 0 and data[STAMP_BYTES + 4] <= (8 if length == _CLASSIC_PACKET else 64)


@compiled
def word_of(data: Any) -> int:
    """The identifier of a packet, with its flags."""
    word: Any = np.int64(bits_at(data, STAMP_BYTES, 4, 0))
    return int(word)


@compiled
def priority_of(word: int) -> int:
    """What the arbitration compares, as ``testbus/frame.py`` has it."""
    if word & _EXTENDED != 0:
        return (((word >> 18) & 0x7FF) << 21) | (3 << 19) | ((word & 0x3FFFF) << 1)
    return word << 21


@compiled
def arrival_of(c: Any) -> int:
    """When the next packet of a client was sent, and so queued."""
    sent_ns = np.int64(bits_at(c["socket"]["received"][c["next"]], 0, STAMP_BYTES, 0))
    return int(min(sent_ns, c["heard_ns"]))


@compiled
def first_arrival(h: Any) -> int:
    """Since when a frame waits for the bus."""
    first: int = FAR_NS
    for m in range(h["messages"]):
        if h["message"][m]["waits"] != 0:
            first = min(first, h["message"][m]["arrival_ns"])
    for i in range(h["clients"]):
        if h["client"][i]["next"] < h["client"][i]["waiting"]:
            first = min(first, arrival_of(h["client"][i]))
    return first


@compiled
def next_event(h: Any) -> int:
    """When something happens on a bus: a sample is due, a frame ends, or one begins."""
    first: int = h["end_ns"]
    if h["sender"] == NOBODY:
        first = max(h["free_ns"], first_arrival(h))
    for m in range(h["messages"]):
        first = min(first, h["message"][m]["due_ns"])
    return first


@compiled
def next_delivery(h: Any) -> int:
    """Not later than the next end of a frame that a client waits for."""
    if h["clients"] == 0:
        return FAR_NS
    free_ns = h["free_ns"]
    if h["sender"] != NOBODY:
        free_ns = h["end_ns"]
        if h["sender"] >= MAX_CLIENTS or h["clients"] > 1:
            return int(free_ns)
    first: int = FAR_NS
    for m in range(h["messages"]):
        t = h["message"][m]
        ready_ns = t["arrival_ns"] if t["waits"] != 0 else t["due_ns"]
        first = min(first, max(free_ns, ready_ns) + t["duration_ns"])
    if h["clients"] > 1 and first_arrival(h) < FAR_NS:
        first = min(first, free_ns)
    return first


@compiled
def let_happen(d: Any, h: Any, outputs: Any, signals: Any, errors: Any, at_ns: int, now: int) -> bool:
    """What happens on a bus at `at_ns`; False where it is Python's.

    Of messages that are due at once the one with the longest period comes first, as its timer in Python would.
    """
    if h["sender"] == NOBODY and max(h["free_ns"], first_arrival(h)) <= at_ns:
        begin(h, at_ns)
        return True
    due, period_ns = -1, 0
    for m in range(h["messages"]):
        t = h["message"][m]
        if t["due_ns"] <= at_ns and t["period_ns"] > period_ns:
            due, period_ns = m, t["period_ns"]
    if due >= 0:
        return sample(d, h, h["message"][due], outputs, signals, errors)
    return end(d, h, outputs, signals, now)


@compiled
def sample(d: Any, h: Any, t: Any, outputs: Any, signals: Any, errors: Any) -> bool:
    """Fill a message that is due; False where the one before still waits, or a reading is none."""
    if t["waits"] != 0:
        return False
    due_ns, packet = t["due_ns"], t["packet"]
    if due_ns - d["time_ns"] >= d["period_ns"]:
        advance(d, due_ns, outputs, signals)
        note_errors(errors[0], signals, due_ns)
    for i in range(t["bytes"]):
        packet[i] = t["empty"][i]
    for i in range(t["field"], t["field"] + t["fields"]):
        f = h["field"][i]
        value = 1.0 if f["channel"] == ONE else 0.0
        if f["channel"] >= 0:
            value = signals[f["channel"]]["value"]
        if not put_nearest(f, packet, FIRST, value, h["scratch"]):
            return False
    if t["counter"]["bits"] > 0:
        put_code(t["counter"], packet, FIRST, np.uint64(t["count"]))
    t["count"] += 1
    t["sent"] += 1
    t["waits"], t["arrival_ns"] = 1, due_ns
    t["due_ns"] += t["period_ns"]
    return True


@compiled
def begin(h: Any, at_ns: int) -> None:
    """Give the bus to the lowest identifier that waits."""
    lowest, duration_ns = FAR_NS, 0
    for m in range(h["messages"]):
        t = h["message"][m]
        if t["waits"] != 0 and t["arrival_ns"] <= at_ns and t["priority"] < lowest:
            lowest, duration_ns, h["sender"] = t["priority"], t["duration_ns"], MAX_CLIENTS + m
    for i in range(h["clients"]):
        c = h["client"][i]
        if c["next"] < c["waiting"] and arrival_of(c) <= at_ns:
            data = c["socket"]["received"][c["next"]]
            priority = priority_of(word_of(data))
            if priority < lowest:
                lowest, duration_ns, h["sender"] = priority, duration_of(h, c), i
    h["end_ns"] = at_ns + duration_ns
    h["busy_ns"] += duration_ns


@compiled
def duration_of(h: Any, c: Any) -> int:
    """How long the next packet of a client keeps the bus."""
    data, kind = c["socket"]["received"][c["next"]], 0
    if length_of(c["socket"], c["next"]) == PACKET_BYTES:
        kind = 2 if data[STAMP_BYTES + 5] & _SWITCHES != 0 else 1
    return int(h["duration_ns"][1 if word_of(data) & _EXTENDED != 0 else 0][kind][data[STAMP_BYTES + 4]])


@compiled
def end(d: Any, h: Any, outputs: Any, signals: Any, now: int) -> bool:
    """End the frame that is on the bus: it is the others'. False where what its sender has next is Python's."""
    sender, end_ns = h["sender"], h["end_ns"]
    h["sender"], h["free_ns"] = NOBODY, end_ns
    h["frames"] += 1
    if sender >= MAX_CLIENTS:
        t = h["message"][sender - MAX_CLIENTS]
        t["waits"] = 0
        if h["clients"] > 0:
            d["late_ns"] = max(d["late_ns"], now - end_ns)
        return deliver(h, t["packet"], t["bytes"], end_ns, NOBODY)
    c = h["client"][sender]
    k = c["next"]
    packet, length = c["socket"]["received"][k], length_of(c["socket"], k)
    take(d, h, packet, outputs, signals, end_ns, now)
    if not deliver(h, packet, length, end_ns, sender):
        c["next"] += 1
        return False
    c["next"] += 1
    if c["next"] < c["waiting"]:
        return is_plain(h, c)
    return c["waiting"] < BATCH or listen(h, now)


@compiled
def deliver(h: Any, packet: Any, length: int, end_ns: int, sender: int) -> bool:
    """Hand a frame that ended then to all clients but its sender; False where one does not take it."""
    dropped = 0
    put_bits(packet, 0, STAMP_BYTES, 0, np.uint64(end_ns))
    for i in range(h["clients"]):
        if i == sender:
            continue
        s = h["client"][i]["socket"]
        for j in range(length):
            s["sent"][j] = packet[j]
        if send(s, length) != 0:
            h["client"][i]["dropped"] += 1
            dropped += 1
    return dropped == 0


@compiled
def take(d: Any, h: Any, packet: Any, outputs: Any, signals: Any, end_ns: int, now: int) -> None:
    """Act on a frame of a client, if it is a command."""
    word = word_of(packet)
    for m in range(h["commands"]):
        t = h["command"][m]
        if t["word"] != word:
            continue
        if packet[STAMP_BYTES + 4] < t["length"]:
            h["not_understood"] += 1
            return
        h["received"] += 1
        finite = 1
        for i in range(t["field"], t["field"] + t["fields"]):
            h["value"][i] = value_at(h["field"][i], packet, FIRST, h["scratch"])
            finite &= 1 if math.isfinite(h["value"][i]) else 0
        if t["fields"] == 0 or finite == 0:
            h["refused"] += 1 - finite
            return
        h["heard_ns"] = now
        for i in range(t["field"], t["field"] + t["fields"]):
            f = h["field"][i]
            outputs[f["channel"]] = h["value"][i]
            note(f["arrived"], h["value"][i])
        advance(d, end_ns, outputs, signals)
        return
