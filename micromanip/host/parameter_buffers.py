"""The parameter buffers that the loop reads in place: which slot may be filled anew, and the counter of versions.

The loop keeps references to three of them: the set in force, the candidate, and the set before a promotion,
which it may put in force again by itself. None of them, nor one that was handed over and not taken yet, is ever filled.
"""

from __future__ import annotations

from typing import Any

from micromanip.errors import CheckFailed
from micromanip.rt import mailbox as w
from micromanip.rt.mailbox import tell
from micromanip.rt.states import SHADOWING

from .shared_memory import SLOTS


class ParameterBuffers:
    """Written by the host only; the loop is told by a word after its slot is complete."""

    def __init__(self, control: Any, told: Any, first: Any) -> None:
        """`control` is the record CONTROL, `told` the loop's words, `first` the set that the loop starts with."""
        self._slots, self._words, self._told = control["parameters"], control["words"], told
        self._newest = 0
        self._version = int(first["version"])
        self._before: int | None = None
        self._handed_over: set[int] = set()
        self._slots[0] = first
        self._words[w.VERSION] = self._version

    def put_in_force(self, parameters: Any) -> int:
        """Hand over a set that the loop takes at its next cycle boundary; its version."""
        slot, version = self._fill(parameters)
        self._handed_over.add(slot)
        self._words[w.SLOT] = slot
        tell(self._words, w.VERSION, version)
        return version

    def taken(self) -> None:
        """The loop has in force what was handed over last."""
        self._handed_over.clear()

    def offer(self, parameters: Any) -> int:
        """Hand over a candidate, which takes the place of the one before; its version."""
        slot, version = self._fill(parameters)
        self._words[w.CANDIDATE] = slot
        tell(self._words, w.CANDIDATE_NUMBER, int(self._words[w.CANDIDATE_NUMBER]) + 1)
        return version

    def keep_for_trial(self) -> None:
        """What is in force now may come back by itself: to be called before each promotion.

        One that the loop will refuse, on trial already, must not let go of what that trial may bring back.
        """
        if self._told[w.SHADOW] == SHADOWING:
            self._before = self._in_force()

    def in_use(self) -> set[int]:
        """Slots that the loop may read, now or in a later cycle."""
        used = {int(self._words[w.SLOT]), *self._handed_over}
        if (in_force := self._in_force()) is not None:
            used.add(in_force)
        if self._words[w.CANDIDATE_NUMBER]:
            used.add(int(self._words[w.CANDIDATE]))
        if self._before is not None:
            used.add(self._before)
        return used

    @property
    def in_force(self) -> Any | None:
        """The set in force; None before the loop's first cycle."""
        slot = self._in_force()
        return None if slot is None else self._slots[slot]

    @property
    def is_unconfirmed(self) -> bool:
        """Whether a set was handed over that the loop may still take."""
        return bool(self._handed_over)

    def _in_force(self) -> int | None:
        """Slot of the set that the loop says is in force; None before its first cycle."""
        version = int(self._told[w.VERSION_ACTIVE])
        return next((slot for slot in range(SLOTS) if version and self._slots[slot]["version"] == version), None)

    def _fill(self, parameters: Any) -> tuple[int, int]:
        used = self.in_use()
        free = (slot % SLOTS for slot in range(self._newest + 1, self._newest + 1 + SLOTS))
        slot = next((slot for slot in free if slot not in used), None)
        if slot is None:
            raise CheckFailed("nothing was changed: the loop has taken none of the last sets of parameters")
        self._newest, self._version = slot, self._version + 1
        filled = parameters[0].copy()
        filled["version"] = self._version  # never seen with another version by those who look for one
        self._slots[slot] = filled
        return slot, self._version
