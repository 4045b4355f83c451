"""Signals computed from the tracker's own coordinates."""

import numpy as np
import pytest

from micromanip.rt.laws.coordinate_transform import derive_signals
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE, MAX_SIGNALS, SIGNAL

SOURCES, FIRST = (7, 2, 4), 40


class Image:
    """A process image with a frame of three sources."""

    def __init__(self, matrix, offset):
        self.p, self.s = np.zeros(1, CELL_PARAMETERS)[0], np.zeros(1, CELL_STATE)[0]
        self.signals = np.zeros(MAX_SIGNALS, SIGNAL)
        frame = self.p["frame"]
        rows, columns = np.shape(matrix)
        frame["sources"], frame["derived"], frame["first"] = columns, rows, FIRST
        frame["source"][:columns] = SOURCES[:columns]
        frame["matrix"][:rows, :columns], frame["offset"][:rows] = matrix, offset

    def put(self, source, value, time_ns=1000, status=0):
        signal = self.signals[SOURCES[source]]
        signal["value"], signal["time_ns"], signal["status"] = value, time_ns, status
        signal["sequence"] += 1

    def derive(self):
        derive_signals(self.p, self.s, self.signals)
        return self.signals[FIRST : FIRST + 3]


MATRIX, OFFSET = [[1.0, 2.0, 0.0], [0.0, 0.5, 0.0], [-1.0, 0.0, 3.0]], [10.0, 0.0, -1.0]


def test_values_are_rows_times_sources_plus_offset():
    image = Image(MATRIX, OFFSET)
    for k, value in enumerate((1.0, 2.0, 4.0)):
        image.put(k, value)
    found = image.derive()
    assert list(found["value"]) == [15.0, 1.0, 10.0]
    assert list(found["sequence"]) == [1, 1, 1]


def test_fresh_only_when_every_source_was():
    image = Image(MATRIX, OFFSET)
    image.put(0, 1.0)
    image.put(1, 1.0)
    assert list(image.derive()["sequence"]) == [0, 0, 0]
    image.put(2, 1.0)
    assert list(image.derive()["sequence"]) == [1, 1, 1]
    assert list(image.derive()["sequence"]) == [1, 1, 1]
    for _ in range(3):  # one that runs ahead makes nothing fresh
        image.put(0, 5.0)
    assert list(image.derive()["sequence"]) == [1, 1, 1]
    image.put(1, 5.0)
    image.put(2, 5.0)
    assert list(image.derive()["sequence"]) == [2, 2, 2]


def test_the_time_is_that_of_the_oldest_and_the_status_of_all():
    image = Image(MATRIX, OFFSET)
    image.put(0, 1.0, time_ns=3000, status=1)
    image.put(1, 1.0, time_ns=1000)
    image.put(2, 1.0, time_ns=2000, status=4)
    found = image.derive()
    assert set(found["time_ns"]) == {1000}
    assert set(found["status"]) == {5}


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_stays_so(value):
    image = Image(MATRIX, OFFSET)
    image.put(0, value)
    image.put(1, 1.0)
    image.put(2, 1.0)
    with np.errstate(invalid="ignore"):  # plain Python tells of infinity times 0
        assert not np.isfinite(image.derive()["value"][0])


def test_without_a_frame_nothing_is_written():
    image = Image(MATRIX, OFFSET)
    image.p["frame"]["sources"] = 0
    assert not image.derive()["sequence"].any()
