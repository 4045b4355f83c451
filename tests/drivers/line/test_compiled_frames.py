"""Compiled functions and Python say the same of every stream of bytes, bit for bit; what is odd is Python's."""

import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from micromanip_drivers.line import frame_reader
from micromanip_drivers.line.binary_options import Binary

from micromanip.bus.driver import Outcome
from micromanip.bus.inbox import Inbox
from micromanip.rt.io.worker_records import NOTHING_SENT, UNCONFIRMED

from ..compiled_turns import assert_sent_alike, bits
from .board import FRAMING, frame
from .compiled_line import Spoken
from .random_frames import Layout

pytestmark = pytest.mark.compiled_only

BOARD = Binary.model_validate(FRAMING["binary"] | {"identity": None})


def strains(count=0, x=0.0, status=0):
    return frame(0x10, struct.pack("<HB3i", count, status, round(x / 1e-4), 0, 0))


def lengths_of(spoken):
    return {message.name: message.length for message in spoken.framing._messages}


def table(spoken):
    """Newest value, status and sequence of each input."""
    rows = spoken.inbox[0]["signal"][: len(spoken.framing.inputs)]
    return [(bits([row["value"]]), int(row["status"]), int(row["sequence"])) for row in rows]


@pytest.fixture(scope="module", autouse=True)
def no_frame_stands_still():
    """However long this machine stands still between two chunks: that is tried with a time of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frame_reader, "STALE_NS", 10**15)
        yield


def compare(seed, pieces):
    """Any stream of a layout; how many chunks compiled code took, and how many there were."""
    draw = random.Random(seed)
    layout = Layout(draw)
    with Spoken(layout.options, False) as theirs, Spoken(layout.options, True) as ours:
        lengths, taken, count = lengths_of(ours), 0, 0
        first = layout.frame("in0", lengths, bytes)
        theirs.begin(first)
        ours.begin(first)
        for chunk in layout.chunks(lengths, pieces):
            theirs.arrives(chunk)
            taken += ours.arrives(chunk) == 0
            count += 1
            assert table(ours) == table(theirs)
        ours.receive_in_python()  # what it knows only then
        assert dict(ours.framing.counters) == dict(theirs.framing.counters)
        assert ours.port.counters == theirs.port.counters
        assert ours.errors == theirs.errors
    return taken, count


@given(st.integers(0, 2**32))
def test_any_stream_is_read_the_same(seed):
    compare(seed, 12)


def test_most_of_an_ordinary_stream_is_compiled():
    """Else the comparison above would compare Python with itself."""
    found = [compare(seed, 20) for seed in range(20)]
    assert sum(taken for taken, _ in found) > 0.3 * sum(count for _, count in found)


@given(st.integers(0, 2**32))
def test_any_values_are_sent_the_same_or_refused_the_same(seed):
    draw = random.Random(seed)
    layout = Layout(draw)
    with Spoken(layout.options, False) as theirs, Spoken(layout.options, True) as ours:
        first = layout.frame("in0", lengths_of(ours), bytes)
        theirs.begin(first)
        ours.begin(first)
        fields = [
            (field, None if field.type.startswith("float") else field.numbers)
            for field in layout.options.send["out"].fields.values()
        ]

        def said(values):
            assert theirs.framing.perform(0, values, Inbox()) is Outcome.SENT
            return theirs.heard()

        assert_sent_alike(draw, fields, said, ours.send, ours.heard, UNCONFIRMED)


def test_python_and_compiled_code_take_turns_in_the_middle_of_a_frame():
    with Spoken(BOARD, True) as at:
        at.begin(strains())
        data = b"".join(strains(count, 0.5 * count) for count in range(1, 40))
        for number, begin in enumerate(range(0, len(data), 7)):
            at.port.far.send(data[begin : begin + 7])
            if number % 3 == 2:
                at.receive_in_python()
            else:
                assert at.receive() == 0
        at.receive_in_python()
        assert at.inbox[0]["signal"]["sequence"][:3].tolist() == [39, 39, 39]
        assert float(at.inbox[0]["signal"]["value"][0]) == pytest.approx(19.5)
        assert at.framing.counters["frames"] == 39
        assert at.framing.counters["lost"] == at.framing.counters["bad_frames"] == 0


def test_what_is_odd_is_left_with_all_behind_it_and_taken_by_python():
    damaged = bytearray(strains(2))
    damaged[9] ^= 1
    with Spoken(BOARD, True) as at:
        at.begin(strains())
        at.port.far.send(strains(1, 1.0) + bytes(damaged) + strains(3, 3.0) + strains(4, 4.0)[:9])
        assert at.receive_compiled() == 1
        assert float(at.inbox[0]["signal"]["value"][0]) == 1.0
        assert at.receive_compiled() == 1, "it takes nothing more before Python has taken what it left"
        assert at.send([0.0, 0.0, 0.0]) == NOTHING_SENT
        at.receive_in_python()
        assert (float(at.inbox[0]["signal"]["value"][0]), at.errors) == (3.0, 1)
        assert at.arrives(strains(4, 4.0)[9:]) == 0
        assert (float(at.inbox[0]["signal"]["value"][0]), at.framing.counters["lost"]) == (4.0, 1)
        assert at.arrives(strains(7, 7.0)) == 0
        assert at.inbox[0]["missing"][:3].tolist() == [3, 3, 3], "two of them by compiled code"
        assert at.inbox[0]["signal"]["sequence"][0] == 7


def test_a_frame_that_stands_still_is_given_up_by_python():
    with Spoken(BOARD, True) as at:
        at.begin(strains())
        assert at.arrives(strains(1)[:10]) == 0
        at.record["chunk_ns"][0] -= frame_reader.STALE_NS
        assert at.receive() == 1
        assert at.framing.counters["bad_frames"] == 1
        assert at.arrives(strains(2, 2.0)) == 0
        assert float(at.inbox[0]["signal"]["value"][0]) == 2.0


def test_what_the_system_takes_in_part_goes_out_whole():
    """The rest of it is Python's to send, and nothing goes before."""
    with Spoken(BOARD, True) as at:
        at.begin(strains())
        assert at.send([0.0] * 3) == UNCONFIRMED
        first = at.heard()
        at.record["unsent"] = 5  # as if it had taken 8 of the 13 bytes
        assert at.send([0.0] * 3) == NOTHING_SENT
        at.receive_in_python()
        assert at.heard() == first[8:]
        assert at.send([0.0] * 3) == UNCONFIRMED
