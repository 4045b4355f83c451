"""The ring's reader against a writer that never waits: what it returns is whole, in order, and counted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.host.shared_memory import RingReader

SIZE = 8
FIELDS = np.dtype([("cycle", "i8"), ("value", "i8")])


class Ring(dict):
    """A ring whose writer goes on while a reader copies: half a row, the other half, then the head.

    `pace` says how many of these half steps happen before each row that is copied, in the middle of it too.
    """

    def __init__(self, pace=()):
        self.step, self.pace = 0, iter(pace)
        self.storage = np.full(SIZE, -1, FIELDS)
        super().__init__(words=np.zeros(1, np.int64), rows=self)

    def write(self, half_steps):
        for _ in range(half_steps):
            number, part = divmod(self.step, 3)
            if part < 2:
                self.storage[number % SIZE][FIELDS.names[part]] = number
            else:
                self["words"][0] = number + 1
            self.step += 1

    def write_rows(self, count):
        self.write(3 * count)

    def __len__(self):
        return SIZE

    def __getitem__(self, key):
        if isinstance(key, str):
            return super().__getitem__(key)
        if np.isscalar(key):
            return self.storage[key]
        places = range(*key.indices(SIZE))
        copied = np.empty(len(places), FIELDS)
        for k, index in enumerate(places):
            for name in FIELDS.names:
                self.write(next(self.pace, 0))
                copied[k][name] = self.storage[index][name]
        return copied


def assert_whole(rows):
    assert (rows["cycle"] == rows["value"]).all(), f"a torn row: {rows}"


def test_begins_where_the_ring_is():
    ring = Ring()
    ring.write_rows(20)
    reader = RingReader(ring)
    assert len(reader.read()) == 0
    ring.write_rows(2)
    assert list(reader.read()["cycle"]) == [20, 21]
    assert reader.lost == 0


@pytest.mark.parametrize("written", [SIZE, SIZE + 1, 3 * SIZE + 5, 1000])
def test_lapped_rows_are_counted(written):
    """The row that the writer may be at is given up too: one less than the ring holds."""
    ring = Ring()
    reader = RingReader(ring)
    ring.write_rows(written)
    rows = reader.read()
    assert list(rows["cycle"]) == list(range(written - SIZE + 1, written))
    assert reader.lost == written - SIZE + 1
    ring.write_rows(1)
    assert list(reader.read()["cycle"]) == [written]


@given(
    st.lists(
        st.tuples(st.integers(0, 40), st.integers(1, 12), st.lists(st.integers(0, 6), max_size=2 * SIZE)), max_size=30
    )
)
def test_never_torn_never_twice_never_silently_lost(reads):
    """Whatever the writer's pace: rows rise, are whole, and with those counted as lost make up all."""
    ring = Ring()
    reader = RingReader(ring)
    returned, last = 0, -1
    for before, most, pace in reads:
        ring.write(before)
        ring.pace = iter(pace)
        rows = reader.read(most)
        assert len(rows) <= most
        assert_whole(rows)
        if len(rows):
            assert rows["cycle"][0] > last
            assert (np.diff(rows["cycle"]) == 1).all()
            last = int(rows["cycle"][-1])
        returned += len(rows)
        assert reader.lost + returned == reader.position
    ring.pace = iter(())
    while len(rows := reader.read()):
        assert_whole(rows)
        returned += len(rows)
    assert reader.lost + returned == ring["words"][0]


def test_going_back():
    """As far as is asked, or as there is; what the loop may overwrite next is left, and nothing is skipped ahead."""
    ring = Ring()
    ring.write_rows(11)
    for position, first in ((9, 9), (6, 6), (0, 5), (-3, 5), (20, 11)):
        reader = RingReader(ring)
        reader.go_back(position, 2)
        assert list(reader.read()["cycle"]) == list(range(first, 11))
        assert reader.lost == 0
    early = Ring()
    early.write_rows(3)
    reader = RingReader(early)
    reader.go_back(-5, 2)
    assert list(reader.read()["cycle"]) == [0, 1, 2]
