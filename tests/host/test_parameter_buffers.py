"""No slot that the loop may still read is ever filled anew, whatever is handed over in whatever order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micromanip.errors import CheckFailed
from micromanip.host.parameter_buffers import ParameterBuffers
from micromanip.host.shared_memory import CONTROL, SLOTS
from micromanip.rt import mailbox as w
from micromanip.rt.records import CELL_PARAMETERS
from micromanip.rt.states import CONFIRMED, NO_SHADOW, ON_TRIAL, SHADOWING, TAKEN_BACK

ACTIONS = ("set", "set unheard", "offer", "promote", "take back", "confirm", "burst")


class Loop:
    """What the loop does with the slots: it keeps references to three of them, as `run_loop` does."""

    def __init__(self):
        self.control = np.zeros((), CONTROL)
        self.words = np.zeros_like(self.control["words"])
        first = np.zeros(1, CELL_PARAMETERS)
        first["version"] = 1
        self.buffers = ParameterBuffers(self.control, self.words, first[0])
        self.p = self.before = self.candidate = 0
        self.seen = {0: 1}
        self.shadow, self.taken, self.candidate_number = NO_SHADOW, 1, 0
        self.cycle()

    def cycle(self):
        words = self.control["words"]
        if words[w.VERSION] != self.taken:
            self.taken, self.p, self.shadow = int(words[w.VERSION]), int(words[w.SLOT]), NO_SHADOW
        if words[w.CANDIDATE_NUMBER] != self.candidate_number:
            self.candidate_number, self.candidate = int(words[w.CANDIDATE_NUMBER]), int(words[w.CANDIDATE])
            self.shadow = SHADOWING
        self.publish()

    def publish(self):
        self.seen = {slot: self.version(slot) for slot in (self.p, self.before, self.candidate)}
        self.words[w.VERSION_ACTIVE], self.words[w.SHADOW] = self.version(self.p), self.shadow

    def version(self, slot):
        return int(self.control["parameters"][slot]["version"])

    def unharmed(self):
        """Nothing that the loop refers to and may use has become another set."""
        used = [self.p]
        if self.shadow == SHADOWING:
            used.append(self.candidate)
        if self.shadow == ON_TRIAL:
            used.append(self.before)
        return all(self.version(slot) == self.seen[slot] for slot in used)

    def do(self, action):
        new = np.zeros(1, CELL_PARAMETERS)
        if action == "set":
            self.buffers.put_in_force(new)
            assert self.unharmed()
            self.cycle()
            self.buffers.taken()
        elif action == "set unheard":
            self.buffers.put_in_force(new)
        elif action == "offer" and self.shadow != ON_TRIAL:
            self.buffers.offer(new)
            assert self.unharmed()
            self.cycle()
        elif action == "promote":
            self.buffers.keep_for_trial()
            if self.shadow == SHADOWING:
                self.before, self.p, self.shadow = self.p, self.candidate, ON_TRIAL
                self.publish()
        elif action == "take back" and self.shadow == ON_TRIAL:
            self.p, self.shadow = self.before, TAKEN_BACK
            self.publish()
        elif action == "confirm" and self.shadow == ON_TRIAL:
            self.shadow = CONFIRMED
            self.publish()
        elif action == "burst":  # more than the host ever does, and with no answer of the loop in between
            for _ in range(SLOTS + 3):
                self.buffers._fill(new)
                assert self.unharmed()
        assert self.unharmed()


@given(st.lists(st.sampled_from(ACTIONS), max_size=30))
@settings(max_examples=60, deadline=None)
def test_what_the_loop_reads_is_never_filled(actions):
    loop = Loop()
    for action in actions:
        loop.do(action)


def test_a_loop_that_takes_nothing():
    """Rather refused than a slot filled that it may be about to read."""
    loop = Loop()
    for _ in range(SLOTS - 1):
        loop.buffers.put_in_force(np.zeros(1, CELL_PARAMETERS))
    with pytest.raises(CheckFailed, match="the loop has taken none of the last sets"):
        loop.buffers.put_in_force(np.zeros(1, CELL_PARAMETERS))
    assert loop.unharmed()
