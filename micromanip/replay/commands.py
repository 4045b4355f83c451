"""Which commands were carried out, by what the states did.

Nothing arms, holds, lets go or resets by itself: what no fault explains was a command. One that was refused left
nothing behind; a stop shows where OFF is reached, and does the same there as any time before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.states import (
    ARM,
    ARMING,
    BEGIN_PART,
    DISARM,
    END_PART,
    FAULT,
    HOLD,
    HOLDING,
    NO_COMMAND,
    NO_FAULT,
    OFF,
    RAMPING,
    READY,
    RESET,
    STOP,
    TRACKING,
)
from micromanip.rt.telemetry import PART_RUNS, PART_TURN

_ALWAYS = {
    (READY, ARMING): ARM,
    (HOLDING, ARMING): ARM,
    (FAULT, READY): RESET,
    (READY, OFF): STOP,
    (FAULT, OFF): STOP,
    (RAMPING, OFF): STOP,
}
_WITHOUT_A_NEW_FAULT = {
    (TRACKING, HOLDING): HOLD,
    (ARMING, HOLDING): HOLD,
    (TRACKING, RAMPING): DISARM,
    (ARMING, RAMPING): DISARM,
    (HOLDING, RAMPING): DISARM,
}


def infer_commands(rows: NDArray[Any], before: Any, wired: bool) -> NDArray[np.int64]:
    """The command (n,) of each of the `rows` (n,); `before` is the cell's state before them.

    `wired`: a signal says which part is made, not a command.
    """
    commands = np.full(len(rows), NO_COMMAND, np.int64)
    states, faults = np.append(before["state"], rows["state"]), np.append(before["fault"], rows["fault"])
    for k in np.flatnonzero(np.diff(states)):
        change = (int(states[k]), int(states[k + 1]))
        commands[k] = _ALWAYS.get(change, NO_COMMAND)
        if faults[k + 1] in (NO_FAULT, faults[k]):
            commands[k] = _WITHOUT_A_NEW_FAULT.get(change, commands[k])
    if not wired:
        runs = np.append(before["part"] != 0, rows["lines"] & PART_RUNS != 0)
        turn = np.append(before["parts"] % 2 != 0, rows["lines"] & PART_TURN != 0)
        commands[runs[:-1] & ~runs[1:] & (states[1:] == TRACKING)] = END_PART
        commands[turn[:-1] != turn[1:]] = BEGIN_PART
    return commands
