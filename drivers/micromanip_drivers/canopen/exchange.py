"""What the worker's compiled loop calls: take the PDOs that came, send SYNC, RPDOs and our heartbeat.

Frames are those of ``canbus``. Heartbeats and emergencies of the nodes, and SYNCs that are not ours, wait for Python,
which has its turn when the samples have been handed to the loop (``driver.py``).
"""

from __future__ import annotations

from typing import Any

from micromanip.driver import now_ns
from micromanip.driver.steady import steady_entries

from ..canbus.bit_codec import low_bytes
from ..canbus.exchange import GONE, give, needs_python, put_samples, take_all
from .sampling import CONTEXT, REPEATED, compiled, note_sync, sampled


@compiled
def leave_pdo(c: Any, number: int, data: Any, first: int, inbox: Any, time_ns: int) -> None:
    """A frame of the TPDO of that number as samples, if it is a fresh one."""
    m = c["received"][number]
    c["pdos"] += 1
    taken_ns, missing = sampled(c["syncs"], c["sampling"][number], time_ns, low_bytes(data, first, m["length"]))
    if missing == REPEATED:
        c["repeated"] += 1
        return
    c["lost"] += missing
    put_samples(c, m, data, first, inbox, taken_ns, 0, missing)


@compiled
def take(c: Any, inbox: Any, began_ns: int) -> int:
    """Take what is there; 0, or 1 where Python has to judge, or a heartbeat is missing.

    That by the time of the frames: what a worker that was held up finds is old, and no reason to miss a heartbeat.
    """
    newest_ns = take_all(c, leave_pdo, inbox, began_ns)
    return 1 if newest_ns == GONE or needs_python(c) or newest_ns > c["overdue_ns"] else 0


@compiled
def give_frame(c: Any, values: Any, task: int) -> int:
    """Send the frame of `task` with `values` of all outputs of the driver; what the worker's loop is told."""
    sent_ns = now_ns(c["socket"]["timespec"])  # before: where we are held up, values count as older than they are
    code: int = give(c, values, task)
    if code == 0 and task == c["sync_task"]:
        note_sync(c["syncs"], sent_ns + c["sync_frame_ns"])
    return code


ENTRIES = steady_entries(compiled, CONTEXT, take, give_frame)
