"""The turns of a bus worker without Python: run due tasks, receive, publish samples, until Python is needed.

It replaces ``bus/worker.py`` while the link is up and the outputs follow the loop, or rest: the same steps in the same
order, with the same gate and schedule in the same records. It returns between two turns if anything else is due:
outputs on the ramp, an unusual frame, an error, changed rules, a report. Python then takes a turn, and calls it again.
The driver has two C functions of the type of ``exchange``:

    int32_t receive(void *context, 0, struct inbox *inbox, int64_t now_ns, 0)      0, or more: Python is needed
    int32_t send(void *context, const double *values, 0, int64_t now_ns, int64_t task)
                                                        0: the device has them; NOTHING_SENT, SENT_IN_DOUBT, UNCONFIRMED

``receive`` takes what is there and never waits. After a code other than 0 and UNCONFIRMED the driver's Python methods
do the rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from micromanip.rt import bus_image as of
from micromanip.rt.bus_exchange import begin_turn, end_turn
from micromanip.rt.intrinsics import call_exchange, fence, load_acquire, now_ns, store_release
from micromanip.rt.jit import compiled
from micromanip.rt.record import Record
from micromanip.rt.signatures import array_of

from .gate import GATE, decide, known_last, may_have_moved, note_sent, note_taken, rests
from .sockets import wait, write_at
from .worker_records import (
    ASKED,
    INBOX,
    LEFT_OVER,
    MEMORY,
    ON_THE_RAMP,
    SENT_IN_DOUBT,
    SERVICE,
    SILENT,
    TURNS,
    UNCONFIRMED,
    advance,
    first_due,
    sealed,
    turn_ns,
)

_sealed = compiled(sealed)


@compiled
def take_wanted(g: Record, image: Record) -> None:
    """Read the loop's outputs and their time; unchanged while the loop is writing."""
    words = image["words"]
    for _ in range(of.TRIES):
        turn = load_acquire(words, of.OUTPUT_TURN)
        if turn & 1 != 0:
            continue
        for i in range(g["outputs"][0]):
            g["value"][i] = image["value"][i]  # no more than scratch: it is decided anew after this
        written_ns = load_acquire(words, of.WRITTEN_NS)
        fence()
        if load_acquire(words, of.OUTPUT_TURN) == turn:
            for i in range(g["outputs"][0]):
                g["wanted"][i] = g["value"][i]
            g["written_ns"][0] = written_ns
            return


@compiled
def publish(image: Record, inbox: Record) -> int:
    """Publish fresh samples to the loop; how many inputs have one."""
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
def take(g: Record, image: Record, memory: Record, task: int, now: int) -> None:
    """The device has taken the last values of `task`: record that in gate, image and file."""
    if not note_taken(g, task, now):
        return
    words = image["words"]
    begin_turn(words, of.SENT_TURN)
    for i in range(g["outputs"][0]):
        image["sent"][i] = known_last(g, i)
    words[of.SENT_NS] = now
    end_turn(words, of.SENT_TURN)
    if memory["file"][0] < 0:
        return
    turn = memory["turn"][0] + 1  # as ``bus/last_given.py`` writes it
    slot = memory["slot"][: g["outputs"][0] + 2]
    memory["turn"][0] = slot[0] = turn
    for i in range(g["outputs"][0]):
        slot.view(np.float64)[1 + i] = known_last(g, i)
    slot[len(slot) - 1] = _sealed(slot, memory["seed"][0])
    write_at(memory["file"][0], slot, memory["place"][turn % 2])


@compiled
def perform(st: Record, g: Record, t: Record, image: Record, memory: Record, task: int, now: int) -> int:
    """Do `task` with what was decided; 0, or what ``send`` says, or SILENT."""
    if may_have_moved(g, task, now):
        return SILENT
    code = call_exchange(st["send"], st["context"], g["value"].ctypes.data, 0, now, task)
    after_ns = now_ns(st["timespec"])
    done = code == 0 or code == UNCONFIRMED
    if t["writes"][task] != 0 and (done or code == SENT_IN_DOUBT):
        note_sent(g, task, now, after_ns)
    if not done:
        return code
    advance(t, task, now)
    st["calls"] += 1
    st["performed"] += 1
    for i in range(g["outputs"][0]):
        if g["task"][i] == task:
            store_release(image["turned_ns"], i, now)
    if code == 0:
        take(g, image, memory, task, after_ns)
    return 0


@compiled
def listen(st: Record, g: Record, image: Record, inbox: Any, memory: Record, now: int, due_ns: int) -> int:
    """Wait until `due_ns`, or for what comes before, and hand it over; 0, or why Python is needed."""
    ready = wait(st["poll"], st["descriptor"], min(due_ns, now + st["look_ns"]) - now, st["timespec"])
    if ready < 0:
        return ASKED
    if ready == 0 and now - st["listened_ns"] < st["look_ns"]:
        return 0
    st["listened_ns"] = now
    code = call_exchange(st["receive"], st["context"], 0, inbox.ctypes.data, now, 0)
    for k in range(len(inbox[0]["confirmed"])):
        if inbox[0]["confirmed"][k] != 0:
            inbox[0]["confirmed"][k] = 0
            take(g, image, memory, k, now_ns(st["timespec"]))
    if publish(image, inbox[0]) > 0:
        st["calls"] += 1
    return 0 if code == 0 else LEFT_OVER


_RECORDS = SERVICE, GATE, TURNS, of.IMAGE, INBOX, MEMORY


@compiled.entry(types.int64(*map(array_of, _RECORDS)))
def serve(service: Any, gate: Any, turns: Any, images: Any, inbox: Any, memories: Any) -> int:
    """Serve until Python is needed; why it is."""
    st, g, t, image, memory = service[0], gate[0], turns[0], images[0], memories[0]
    words = image["words"]
    while True:
        now = now_ns(st["timespec"])
        store_release(words, of.ALIVE_NS, now)
        if load_acquire(st["leave"], 0) != 0 or now >= st["until_ns"]:
            return ASKED
        task = first_due(t)
        due_ns = turn_ns(t, task) if task >= 0 else now + st["look_ns"]
        is_due = task >= 0 and due_ns <= now
        if is_due or now - g["decided_ns"][0] >= st["look_ns"]:
            take_wanted(g, image)
            decide(g, now)
            store_release(words, of.AT_REST, 1 if rests(g) else 0)
            store_release(words, of.OUTPUT_STATE, g["state"][0])
            if g["state"][0] == of.SAFE_RAMP:
                return ON_THE_RAMP
        if is_due:
            code = perform(st, g, t, image, memory, task, now)
        else:
            code = listen(st, g, image, inbox, memory, now, due_ns)
        if code != 0:
            return code
