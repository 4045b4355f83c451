"""States and controlwords of a drive against tables that others wrote, and any sequence of what a drive may say."""

import math
import struct
from itertools import pairwise

import numpy as np
import pytest
from canopen.profiles.p402 import State402
from hypothesis import given
from hypothesis import strategies as st
from micromanip_drivers.ethercat.bring_up import prepare_drive
from micromanip_drivers.ethercat.drive_options import Drive
from micromanip_drivers.ethercat.drive_records import FAULT, UNKNOWN
from micromanip_drivers.ethercat.drive_words import STATE_NAMES, DriveWords
from micromanip_drivers.ethercat.driver import Ethercat
from micromanip_drivers.ethercat.drives import command_drives, controlword, hear_drives, state_of
from micromanip_drivers.ethercat.image import Image
from micromanip_drivers.ethercat.records import CONTEXT

from micromanip.bus.errors import DeviceFault
from micromanip.bus.safe_state import VOLTAGE, SafeOutput
from micromanip.rt.records import SIGNAL

from .bench import PERIOD_NS, options
from .drive_bench import DRIVE, SCALE, drive

TAKEN, FOLLOWED = -2, 0
GOOD = 0x1000 | 0x200 | 0x10
OPERATES = GOOD | 0x27


def test_states_are_those_of_canopens_table():
    for status in (low | high for low in range(0x80) for high in (0, 0x80, 0x1210, 0xFF90)):
        named = [name for name, (mask, value) in State402.SW_MASK.items() if status & mask == value]
        assert len(named) <= 1
        found = state_of(status)
        assert (STATE_NAMES[found].upper() if found != UNKNOWN else None) == (named[0] if named else None)


def test_each_controlword_takes_the_transition_that_canopens_table_has_for_it():
    way = ["SWITCH ON DISABLED", "READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"]
    for here, there in pairwise(way):
        state = STATE_NAMES.index(here.capitalize())
        assert State402.next_state_indirect(here) == there
        assert controlword(state, True, True, False, 0) == State402.TRANSITIONTABLE[here, there]
    for here in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED", "QUICK STOP ACTIVE"):
        state = STATE_NAMES.index(here.capitalize())
        assert controlword(state, False, True, False, 0) == State402.TRANSITIONTABLE[here, "SWITCH ON DISABLED"]
    assert controlword(FAULT, False, True, True, 0) == State402.TRANSITIONTABLE["FAULT", "SWITCH ON DISABLED"]
    enabled, stopped = STATE_NAMES.index("Operation enabled"), "QUICK STOP ACTIVE"
    assert controlword(enabled, False, True, False, 2) == State402.TRANSITIONTABLE["OPERATION ENABLED", stopped]


class Talk:
    """The driver's laws of a drive without a wire: what it says, and what it is sent."""

    def __init__(self, keys=DRIVE):
        self.options = options(terminals={"stage": keys})
        self.driver, self.image = Ethercat(self.options, PERIOD_NS), Image(self.options)
        context = self.driver.context()
        self.driver.adopt(context, [SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, 5.0 / (1e-9 * PERIOD_NS))])
        self.c = context.view(CONTEXT)[0]
        self.inputs, self.frame = np.zeros(8, SIGNAL), np.zeros(128, np.uint8)
        self.now_ns = 0

    def hear(self, status, mode=8, position_V=0.0, error=0):
        placed = self.image.placed["stage"]
        at = self.image.image_at + placed.inputs_at
        said = struct.pack("<HbiH", status, mode, round(position_V / SCALE), error)
        self.frame[at : at + len(said)] = np.frombuffer(said, np.uint8)
        hear_drives(self.c, self.frame, self.inputs, self.now_ns)

    def command(self, code, wanted_V, permitted, resets):
        """The controlword of a cycle, and the target in it."""
        self.now_ns += PERIOD_NS
        outputs = np.array([wanted_V, float(permitted), float(resets)])
        command_drives(self.c, code, outputs, self.now_ns)
        at = self.image.image_at
        self.c["gate"]["last"][0] = self.c["asked"][0]  # as the gate does
        return int(self.c["send"]["template"][at : at + 2].view(np.uint16)[0]), float(self.c["asked"][0])

    @property
    def ok(self):
        return float(self.inputs[self.driver.inputs.index("amplifier_ok")]["value"])


OBEYS = {(0x40, 0x06): 0x21, (0x21, 0x07): 0x23, (0x23, 0x0F): 0x27, (0x08, 0x80): 0x40}
"""A drive that does as it is told: from one statusword to the next by the controlword."""
CYCLE = st.tuples(
    st.sampled_from([None] * 12 + [0x00, 0x40, 0x27, 0x07, 0x0F, 0x08, 0x08]) | st.integers(0, 0xFFFF),
    st.sampled_from([8] * 9 + [1]),
    st.sampled_from([0.0, 0.0, 12.0, 200.0]),
    st.sampled_from([FOLLOWED] * 12 + [TAKEN, -1]),
    st.sampled_from([True] * 9 + [False]),
    st.sampled_from([False] * 4 + [True]),
    st.sampled_from([True] * 4 + [False]),
)


def obeyed(status, word):
    """What it says next; an ordinary word takes its power, but not its fault."""
    plain = status & 0x6F
    if plain == 0x08:
        return GOOD | OBEYS.get((0x08, word), 0x08)
    return GOOD | (OBEYS.get((plain, word), plain) if word & 2 else 0x40)


def is_in(name, status):
    """By canopen's table."""
    mask, value = State402.SW_MASK[name]
    return status & mask == value


@given(st.lists(CYCLE, min_size=30, max_size=60), st.sampled_from(["disable_voltage", "quick_stop"]))
def test_nothing_that_a_drive_says_enables_it_without_permission_or_resets_it_without_the_operator(cycles, stop):
    talk = Talk(drive(stop=stop))
    counts = asked = operated = False  # the permission, once it has been taken back
    before, known, resetting, reset_before = 0, 0x40, False, True
    for status, mode, position_V, code, permitted, resets, is_heard in cycles:
        status = obeyed(known, before) if status is None else status
        if is_heard:
            known = status
            talk.hear(status, mode, position_V)
            good = is_in("OPERATION ENABLED", status) and mode == 8 and status & 0x3000 == 0x1000
            faulty = is_in("FAULT", status) or is_in("FAULT REACTION ACTIVE", status)
            counts = counts and not (asked and not good and (operated or faulty))
            operated = operated or (asked and good)
        if not permitted:
            counts, operated = True, False
        counts = counts and (code == FOLLOWED or not permitted)
        asked = counts and permitted
        is_reset = resets and code == FOLLOWED
        resetting = is_reset and is_in("FAULT", known) and (resetting or not reset_before)
        reset_before = is_reset
        word, target_V = talk.command(code, 40.0, permitted, resets)
        if word & 0x0F in (0x06, 0x07, 0x0F):
            assert asked, "it is switched on by a permission that counts"
        if word & 0x0F == 0x0F:
            assert is_in("SWITCHED ON", known) or is_in("OPERATION ENABLED", known)
        if word & 0x80:
            assert resetting, "in this fault, from the moment on at which the operator asked for it"
            assert word == 0x80
            assert before in (0x00, 0x02, 0x80), "bit 7 rises alone"
        assert not word & 0xFF70, "bits that other modes have"
        d = talk.c["drive"][0]
        if not d["enabled"]:
            nearest_V = min(max(float(d["actual"]), -20.0), 150.0)
            assert target_V == pytest.approx(nearest_V, abs=SCALE), "where it is"
        before = word


@given(st.lists(st.floats(-20.0, 150.0), min_size=1, max_size=50), st.floats(-20.0, 150.0))
def test_a_target_begins_where_the_drive_is_and_is_taken_up_no_faster_than_the_key_says(wanted, found_V):
    talk = Talk()
    talk.hear(0x40, position_V=found_V)
    talk.command(FOLLOWED, 0.0, False, False)
    for status in (0x40, 0x21, 0x23):
        talk.hear(GOOD | status, position_V=found_V)
        assert talk.command(FOLLOWED, wanted[0], True, False)[1] == pytest.approx(found_V, abs=SCALE)
    last_V = found_V
    for value in wanted:
        talk.hear(OPERATES, position_V=last_V)
        had_taken_up = talk.c["drive"][0]["taken_up"]
        target_V = talk.command(FOLLOWED, value, True, False)[1]
        if had_taken_up:
            assert target_V == value
        else:
            assert abs(target_V - last_V) <= 1.0 + 2 * SCALE
        assert abs(target_V - value) <= abs(last_V - value) + 2 * SCALE, "towards it"
        last_V = target_V


@pytest.mark.parametrize("mode", ["csv", "cst"])
def test_without_a_position_the_target_that_moves_nothing_is_the_value_at_rest(mode):
    index, kind, number = {"csv": (0x60FF, "int32", 9), "cst": (0x6071, "int16", 10)}[mode]
    voltage = DRIVE["outputs"]["commands"]["fields"]["voltage"] | {"index": index, "type": kind, "range": (-3, 3)}
    keys = drive(mode=mode, take_up_V_per_s=None)
    fields = keys["outputs"]["commands"]["fields"] | {"voltage": voltage}
    keys |= {"outputs": {"commands": {"pdo": 0x1600, "fields": fields}}}
    talk = Talk(keys)
    assert int(talk.c["send"]["template"][talk.image.image_at + 2]) == number
    talk.command(FOLLOWED, 2.0, False, False)
    talk.hear(GOOD | 0x23, mode=number)
    assert talk.command(FOLLOWED, 2.0, True, False) == (0x0F, 0.0)
    talk.hear(OPERATES, mode=number)
    assert talk.command(FOLLOWED, 2.0, True, False) == (0x0F, 2.0)
    assert math.isinf(talk.c["drive"][0]["take_up"])


class Kept:
    """A mailbox of a drive that keeps to its own option codes."""

    def __init__(self):
        self.written = {}

    def read_number(self, index, subindex, size):
        raise DeviceFault("there is no such object")

    def write(self, index, subindex, data):
        self.written[index] = data

    def read(self, index, subindex):
        return struct.pack("<h", -1)


def test_a_drive_that_keeps_to_its_own_option_code_is_refused():
    mailbox = Kept()
    with pytest.raises(DeviceFault, match=r"stage keeps option code 0x605a at -1, 2 was written"):
        prepare_drive(mailbox, "stage", Drive(mode="csv", enable="e", ok="o", codes={"quick_stop": 2}))
    assert mailbox.written == {0x605A: b"\2\0"}


@pytest.mark.parametrize(
    ("status", "mode", "said"),
    [
        (OPERATES, 6, "left Operation enabled: it shows mode 6 instead of 8"),
        (OPERATES | 0x2000, 8, "left Operation enabled: following error (bit 13)"),
        (GOOD & ~0x10 | 0x40, 8, "left Operation enabled: it has no main power (bit 4)"),
    ],
)
def test_what_ended_an_operation_is_told_though_the_cell_has_taken_its_permission_back_before_anybody_looked(
    status, mode, said
):
    talk = Talk()
    words = DriveWords(talk.options, talk.c)
    talk.command(FOLLOWED, 0.0, False, False)
    for each in (0x40, 0x21, 0x23, 0x27, 0x27):
        talk.hear(GOOD | each)
        talk.command(FOLLOWED, 0.0, True, False)
    assert talk.ok == 1.0
    assert list(words.news()) == []
    talk.hear(status, mode)
    talk.command(FOLLOWED, 0.0, False, False)
    talk.hear(GOOD | 0x40)
    (news,) = words.news()
    assert f"drive stage {said}" in news
    assert list(words.news()) == [], "once"
