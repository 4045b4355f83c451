"""The host tells a trip once, with its black box, to the journal where there is one."""

from types import SimpleNamespace

import numpy as np
import pytest

from micromanip.host import journal
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


@pytest.fixture
def entries(monkeypatch):
    """What the journal got."""
    taken = []
    monkeypatch.setattr(journal, "is_connected", lambda: True)
    monkeypatch.setattr(journal, "send", lambda fields: taken.append(fields) or True)
    return taken


class Cell:
    """A controller with a latched fault of axis y, or without."""

    def __init__(self):
        self.status = np.zeros(1, STATUS)[0]
        self.words = self.status["words"]
        axes = {"x": None, "y": None}
        self.prepared = SimpleNamespace(source=None, configuration=SimpleNamespace(axes=axes))

    def trip(self, number):
        state = self.status["state"][0]
        state["fault"], state["fault_axis"], state["fault_value"], state["fault_limit"] = STRAIN_INVALID, 1, 53.0, 3.0
        self.words[w.FAULT_CODE], self.words[w.TRIPS] = STRAIN_INVALID, number

    def reset(self):
        self.words[w.FAULT_CODE] = self.status["state"][0]["fault"] = 0

    def fault(self):
        return "X-201 axis y: gone." if self.words[w.FAULT_CODE] else None


@pytest.fixture
def told(tmp_path):
    said = []
    cell = Cell()
    return cell, supervisor.BlackBox(cell, tmp_path, 50, said.append), said


def test_once_with_its_file_as_soon_as_that_is_on_disk(told, clock, monkeypatch):
    monkeypatch.setattr(journal, "is_connected", lambda: False)
    cell, boxes, said = told
    boxes.announce()
    cell.trip(1)
    boxes.announce()
    assert said == []
    boxes._hear({"key": 1, "code": "X-201", "file": "/trips/a.npz", "complete": False})
    for _ in range(3):
        boxes.announce()
    assert said == ["X-201 axis y: gone. Black box: /trips/a.npz"]
    cell.reset()
    boxes.announce()
    cell.trip(2)
    clock.now += 5.0
    boxes.announce()
    clock.now += 1.1  # nothing is heard of the box: the fault is told all the same
    boxes.announce()
    assert said[1:] == ["X-201 axis y: gone."]


def test_a_disk_that_hangs_is_given_up(told, clock, monkeypatch):
    monkeypatch.setattr(journal, "is_connected", lambda: False)
    cell, boxes, said = told
    cell.trip(1)
    boxes.announce()
    clock.now += 31.0
    boxes.announce()
    assert any("nothing was heard of it for 30 s" in message for message in said)
    assert boxes.report()[0]["problem"] == "nothing was heard of it for 30 s"


def test_with_fields_to_the_journal_and_only_there(told, clock, entries):
    cell, boxes, said = told
    cell.trip(1)
    boxes._hear({"key": 1, "code": "X-201", "file": "/trips/a.npz", "complete": False})
    boxes.announce()
    (fields,) = entries
    assert fields["MESSAGE"] == "X-201 axis y: gone. Black box: /trips/a.npz"
    assert (fields["MICROMANIP_CODE"], fields["MICROMANIP_AXIS"]) == ("X-201", "y")
    assert (fields["MICROMANIP_VALUE"], fields["MICROMANIP_LIMIT"]) == ("53", "3")
    assert fields["MICROMANIP_TRIP"] == "/trips/a.npz"
    assert said == []


def test_where_the_journal_takes_nothing_it_is_said(told, clock, monkeypatch):
    monkeypatch.setattr(journal, "is_connected", lambda: True)
    monkeypatch.setattr(journal, "send", lambda fields: False)
    cell, boxes, said = told
    cell.trip(1)
    boxes._hear({"key": 1, "code": "X-201", "file": "/trips/a.npz", "problem": "No space left on device"})
    boxes.announce()
    assert said[-1] == "X-201 axis y: gone."


def test_a_fault_that_ends_the_run_comes_after_the_one_that_nobody_has_heard_of(told, clock, entries):
    """The host stood still while both came; at the end there is nothing to wait for."""
    cell, boxes, said = told
    cell.trip(1)
    state = cell.status["state"][0]
    for name in ("", "_axis", "_value", "_limit"):
        state[f"former{name}"] = state[f"fault{name}"]
    state["fault"], state["fault_axis"], state["fault_value"], state["fault_limit"] = HOST_DEAD, -1, 150.0, 100.0
    cell.words[w.FAULT_CODE], cell.words[w.TRIPS] = HOST_DEAD, 2
    cell.fault = lambda: "X-101 gone."
    cell.faults = lambda: ["X-201 axis y: gone.", "X-101 gone."]
    boxes.announce(last=True)
    assert said == []
    assert [entry["MICROMANIP_CODE"] for entry in entries] == ["X-201", "X-101"]
    assert [entry.get("MICROMANIP_AXIS") for entry in entries] == ["y", None]
    assert [entry["MICROMANIP_VALUE"] for entry in entries] == ["53", "150"]
    boxes.announce(last=True)
    assert len(entries) == 2
