"""The host tells a trip once, with its black box."""

from types import SimpleNamespace

import numpy as np
import pytest

from micromanip.faults import LOOP_DIED, FaultReport, latched
from micromanip.host.shared_memory import STATUS
from micromanip.host.trips import supervisor
from micromanip.rt import mailbox as w
from micromanip.rt.states import HOST_DEAD, STRAIN_INVALID


class Clock:
    now = 100.0

    def monotonic(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(supervisor, "time", clock)
    return clock


class Cell:
    """A controller with a latched fault of axis y, or without."""

    def __init__(self):
        self.status = np.zeros(1, STATUS)[0]
        self.words = self.status["words"]
        self.prepared = SimpleNamespace(source=None)
        self.segments = SimpleNamespace(descriptors=())

    def trip(self, number):
        state = self.status["state"][0]
        state["fault"], state["fault_axis"], state["fault_value"], state["fault_limit"] = STRAIN_INVALID, 1, 53.0, 3.0
        self.words[w.FAULT_CODE], self.words[w.TRIPS] = STRAIN_INVALID, number

    def reset(self):
        self.words[w.FAULT_CODE] = self.status["state"][0]["fault"] = 0

    def latched(self):
        return latched(self.status["state"][0], ["x", "y"], ["cell"])

    def faults(self):
        return [*self.latched(), FaultReport(LOOP_DIED, what="the loop process was killed by signal 9")]


@pytest.fixture
def told(tmp_path):
    said = []
    cell = Cell()
    return cell, supervisor.BlackBox(cell, tmp_path, 50, said.append), said


def test_once_with_its_file_as_soon_as_that_is_on_disk(told, clock):
    cell, boxes, said = told
    boxes.announce()
    cell.trip(1)
    boxes.announce()
    assert said == []
    boxes._hear({"key": 1, "code": "X-201", "file": "/trips/a.npz", "complete": False})
    for _ in range(3):
        boxes.announce()
    (report,) = said
    assert (report.kind.code, report.axis, report.value, report.limit) == ("X-201", "y", 53.0, 3.0)
    assert report.box == "/trips/a.npz"
    cell.reset()
    boxes.announce()
    cell.trip(2)
    clock.now += 5.0
    boxes.announce()
    clock.now += 1.1  # nothing is heard of the box: the fault is told all the same
    boxes.announce()
    assert [(report.kind.code, report.box) for report in said[1:]] == [("X-201", None)]


def test_a_disk_that_hangs_is_given_up(told, clock):
    cell, boxes, said = told
    cell.trip(1)
    boxes.announce()
    clock.now += 31.0
    boxes.announce()
    assert any("nothing was heard of it for 30 s" in str(message) for message in said)
    assert boxes.report()[0]["problem"] == "nothing was heard of it for 30 s"


def test_a_fault_that_ends_the_run_comes_after_the_one_that_nobody_has_heard_of(told, clock):
    """The host stood still while both came; at the end there is nothing to wait for."""
    cell, boxes, said = told
    cell.trip(1)
    state = cell.status["state"][0]
    for name in ("", "_axis", "_value", "_limit"):
        state[f"former{name}"] = state[f"fault{name}"]
    state["fault"], state["fault_axis"], state["fault_value"], state["fault_limit"] = HOST_DEAD, -1, 150.0, 100.0
    cell.words[w.FAULT_CODE], cell.words[w.TRIPS] = HOST_DEAD, 2
    boxes.announce(last=True)
    assert [(report.kind.code, report.axis, report.value) for report in said] == [
        ("X-201", "y", 53.0),
        ("X-101", None, 150.0),
    ]
    boxes.announce(last=True)
    assert len(said) == 2
