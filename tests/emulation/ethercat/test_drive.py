"""The emulated drive against the transitions of the profile, as canopen's table has them."""

import struct
from itertools import pairwise

import numpy as np
import pytest
from canopen.profiles.p402 import State402
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus.ethercat.al_states import OP, SAFEOP
from micromanip.bus.ethercat.registers import AL_STATUS
from micromanip.emulation.ethercat.controller import ESC
from micromanip.emulation.ethercat.drive import DRIVE as RECORD
from micromanip.emulation.ethercat.drive import fill_drive, step_drives
from micromanip.emulation.ethercat.terminal import INPUTS, OUTPUTS

from .terminals import DRIVE

STEP_NS = 1_000_000
WAY = ["SWITCH ON DISABLED", "READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"]
AUTOMATIC = {
    ("NOT READY TO SWITCH ON", "SWITCH ON DISABLED"),
    ("FAULT REACTION ACTIVE", "FAULT"),
    ("QUICK STOP ACTIVE", "SWITCH ON DISABLED"),
}
OF_OTHER_CODES = {("QUICK STOP ACTIVE", "OPERATION ENABLED")}
"""Transition 16 is for option codes 5 to 8 of the quick stop, which this drive has not."""
BY_WORD = {pair for pair in State402.TRANSITIONTABLE if "START" not in pair} - AUTOMATIC - OF_OTHER_CODES


class Alone:
    """A drive behind a slave, without a wire."""

    def __init__(self):
        self.drives, self.slaves = np.zeros(1, RECORD), np.zeros(1, ESC)
        fill_drive(self.drives, 0, DRIVE)
        self.slaves["powered"], self.now_ns = 1, 1_000_000_000
        self.operate(OP)
        self.until("SWITCH ON DISABLED", 0)

    def operate(self, state):
        self.slaves[0]["memory"][AL_STATUS] = state

    def step(self, word, target=0, mode=8):
        """A millisecond with this controlword; the state after it."""
        memory = self.slaves[0]["memory"]
        memory[OUTPUTS : OUTPUTS + 7] = np.frombuffer(struct.pack("<Hbi", word, mode, target), np.uint8)
        self.now_ns += STEP_NS
        step_drives(self.drives, self.slaves, self.now_ns)
        return self.state

    def until(self, state, word):
        for _ in range(100):
            if self.step(word) == state:
                return
        raise AssertionError(f"{self.state} instead of {state}")

    def bring_to(self, state):
        if state == "QUICK STOP ACTIVE":
            self.bring_to("OPERATION ENABLED")
            self.step(0x02)
        elif state == "FAULT":
            self.drives[0]["fault"] = 0x8611
            self.until("FAULT", 0)
        else:
            for here in WAY[1 : WAY.index(state) + 1]:
                self.step(State402.CW_COMMANDS_CODE[here])
        assert self.state == state

    @property
    def said(self):
        """Statusword, mode shown, position, error code."""
        return struct.unpack("<HbiH", self.slaves[0]["memory"][INPUTS : INPUTS + 9].tobytes())

    @property
    def state(self):
        (found,) = [name for name, (mask, value) in State402.SW_MASK.items() if self.said[0] & mask == value]
        return found


@pytest.mark.parametrize("pair", sorted(BY_WORD), ids=" to ".join)
def test_each_controlword_of_the_profile_has_its_transition(pair):
    drive = Alone()
    drive.bring_to(pair[0])
    assert drive.step(State402.TRANSITIONTABLE[pair]) == pair[1]


WORDS = st.lists(st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x80, 0x8F]) | st.integers(0, 0xFFFF), max_size=40)


@given(WORDS, st.integers(0, 40), st.sampled_from([0, 0x3210]))
def test_whatever_it_is_told_it_takes_transitions_of_the_profile_only(words, when, fault):
    drive = Alone()
    known, before = BY_WORD | AUTOMATIC, 0
    for k, word in enumerate(words):
        was = drive.state
        if k == when:
            drive.drives[0]["fault"] = fault
        now = drive.step(word)
        if now != was and now not in ("FAULT", "FAULT REACTION ACTIVE"):
            assert (was, now) in known
        if now == "OPERATION ENABLED" != was:
            assert (was, word & 0x0F) == ("SWITCHED ON", 0x0F)
        if was == "FAULT" != now:
            assert word & 0x80
            assert not before & 0x80
        before = word


def test_it_follows_while_it_is_enabled_and_falls_to_rest_after():
    drive = Alone()
    drive.bring_to("OPERATION ENABLED")
    drive.step(0x0F, target=5000)
    assert drive.said[1:] == (8, 5000, 0)
    assert drive.said[0] & 0x1000
    positions = []
    for _ in range(300):
        drive.step(0x00, target=9999)
        positions.append(drive.said[2])
    assert (positions[0], positions[-1]) == (5000, 0)
    assert max(a - b for a, b in pairwise(positions)) <= 26, "in 0.2 s"


@pytest.mark.parametrize(("code", "leads_to"), [(1, "FAULT"), (2, "SWITCH ON DISABLED"), (3, "SWITCH ON DISABLED")])
def test_without_process_data_it_does_what_its_option_code_says(code, leads_to):
    drive = Alone()
    drive.drives[0]["connection_lost"] = code
    drive.bring_to("OPERATION ENABLED")
    drive.operate(SAFEOP)
    drive.until(leads_to, 0x0F)
    drive.operate(OP)
    for _ in range(20):
        assert drive.step(0x00) == leads_to, "and stays there"
    assert (drive.said[3] == 0x7500) == (code == 1)


def test_what_is_injected_shows():
    drive = Alone()
    d = drive.drives[0]
    d["refuses"] = 1
    for word in (0x06, 0x07, 0x0F, 0x0F):
        drive.step(word)
    assert drive.state == "SWITCHED ON"
    d["refuses"], d["wrong_mode"] = 0, 1
    assert drive.step(0x0F) == "OPERATION ENABLED"
    assert drive.said[1] == 6
    d["stuck"] = 1
    for _ in range(20):
        drive.step(0x0F, target=1_000_000)
    assert drive.said[0] & 0x2000, "following error"
    assert drive.said[2] == 0
    d["torque_off"] = 1
    assert drive.step(0x0F) == "SWITCH ON DISABLED"
    assert not drive.said[0] & 0x10
    for _ in range(5):
        assert drive.step(0x06) == "SWITCH ON DISABLED"
