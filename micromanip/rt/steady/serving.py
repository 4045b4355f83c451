"""The turns of a bus worker without Python: do what is due, listen, hand over what came, until Python is needed.

It stands in for ``bus/worker.py`` while the link is up and the outputs follow the loop, or rest; what a turn does
there it does here, in the same order. Anything else ends it, with nothing done by halves: a loop that dies or is there
again, a frame out of the ordinary, an error, rules that have changed, the time for a report. Python then has a turn, by
the code that it always had, and calls again. The driver has two C functions of the type of ``exchange``:

    int32_t receive(void *context, 0, struct inbox *inbox, int64_t now_ns, 0)      0, or more: Python is needed
    int32_t send(void *context, const double *values, 0, int64_t now_ns, int64_t task)
                                                        0: the device has them; NOTHING_SENT, SENT_IN_DOUBT, UNCONFIRMED

``receive`` takes what is there and never waits. After anything but 0 and UNCONFIRMED the driver does in its Python
methods what is left.
"""

from __future__ import annotations

from typing import Any

from numba import types

from micromanip.rt.bus_exchange import begin_turn, end_turn
from micromanip.rt.bus_image import ALIVE_NS, AT_REST, IMAGE
from micromanip.rt.clock import now_ns
from micromanip.rt.intrinsics import call_exchange, load_acquire, store_release
from micromanip.rt.jit import compiled
from micromanip.rt.record import Record
from micromanip.rt.signatures import array_of
from micromanip.rt.wire.datagrams import wait

from .gate import decide, note_given, note_sent, note_turn, rests, state_holds, take_confirmed, take_wanted, was_silent
from .records import ASKED, INBOX, LEFT_OVER, SILENT, STATE_CHANGES, STEADY, UNCONFIRMED


@compiled
def most_due(st: Record) -> int:
    """The task that is due first of all; -1 where there is none."""
    first = -1
    for k in range(st["tasks"]):
        if first < 0 or st["task"][k]["due_ns"] < st["task"][first]["due_ns"]:
            first = k
    return first


@compiled
def advance(st: Record, task: int, now_ns: int) -> None:
    """Its next turn is the first on its grid that is still to come."""
    t = st["task"][task]
    turns = (now_ns - t["due_ns"]) // t["period_ns"] + 1
    t["due_ns"] += turns * t["period_ns"]
    t["performed"] += 1
    st["skipped"] += turns - 1


@compiled
def publish(image: Record, inbox: Record) -> int:
    """Hand fresh samples to the loop; how many inputs have one."""
    fresh = 0
    for i in range(image["inputs"]):
        source, target = inbox["signal"][i], image["input"][i]
        if source["sequence"] == target["sequence"]:
            continue
        begin_turn(image["input_turn"], i)
        target["value"], target["time_ns"] = source["value"], source["time_ns"]
        target["sequence"], target["status"] = source["sequence"], source["status"]
        image["missing"][i] = inbox["missing"][i]
        end_turn(image["input_turn"], i)
        fresh += 1
    return fresh


@compiled
def perform(st: Record, image: Record, slot: Any, values: Any, task: int, now: int) -> int:
    """Do `task` with what was decided; 0, or what ``send`` says, or SILENT."""
    if was_silent(st, task, now):
        return SILENT
    code = call_exchange(st["send"], st["context"], st["value"].ctypes.data, 0, now, task)
    if code != 0 and code != UNCONFIRMED:
        st["failed"] = task
        return code
    advance(st, task, now)
    note_turn(st, image, task, now)
    st["calls"] += 1
    if code == UNCONFIRMED:
        note_sent(st, task, now)
    else:
        note_given(st, image, slot, values, task, st["value"], now, now_ns(st["timespec"]))
    return 0


@compiled
def listen(st: Record, image: Record, inbox: Any, slot: Any, values: Any, now: int, due_ns: int) -> int:
    """Wait until `due_ns`, or for what comes before, and hand it over; 0, or why Python is needed."""
    ready = wait(st["poll"], st["descriptor"], min(due_ns, now + st["look_ns"]) - now, st["timespec"])
    if ready < 0:
        return ASKED
    if ready == 0 and now - st["listened_ns"] < st["look_ns"]:
        return 0
    st["listened_ns"] = now
    code = call_exchange(st["receive"], st["context"], 0, inbox.ctypes.data, now, 0)
    take_confirmed(st, image, inbox[0], slot, values, now_ns(st["timespec"]))
    if publish(image, inbox[0]) > 0:
        st["calls"] += 1
    return 0 if code == 0 else LEFT_OVER


@compiled.entry(types.int64(array_of(STEADY), array_of(IMAGE), array_of(INBOX), types.int64[::1], types.float64[::1]))
def serve(steady: Any, images: Any, inbox: Any, slot: Any, values: Any) -> int:
    """Serve until Python is needed; why it is. `slot` and `values` are a slot of the file of what was given last
    (``bus/last_given.py``), both (0,) where there is none.
    """
    st, image = steady[0], images[0]
    words = image["words"]
    while True:
        now = now_ns(st["timespec"])
        store_release(words, ALIVE_NS, now)
        if load_acquire(st["leave"], 0) != 0 or now >= st["until_ns"]:
            return ASKED
        task = most_due(st)
        due_ns = st["task"][task]["due_ns"] if task >= 0 else now + st["look_ns"]
        is_due = task >= 0 and due_ns <= now
        if is_due or now - st["decided_ns"] >= st["look_ns"]:
            take_wanted(st, image)
            if not state_holds(st, now):
                return STATE_CHANGES
            decide(st)
            st["decided_ns"] = now
            store_release(words, AT_REST, 1 if rests(st) else 0)
        if is_due:
            code = perform(st, image, slot, values, task, now)
        else:
            code = listen(st, image, inbox, slot, values, now, due_ns)
        if code != 0:
            return code
