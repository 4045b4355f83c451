"""Memories on their way into the loop: taken as they were shown, and written while the loop can read none."""

import asyncio
import hashlib

import numpy as np
import pytest

from micromanip.errors import CheckFailed, UsageError
from micromanip.host.learning.service import LearningService
from micromanip.host.parameter_buffers import ParameterBuffers
from micromanip.host.shared_memory import CONTROL, STATUS, Segments
from micromanip.rt import mailbox as w
from micromanip.rt.faults import note
from micromanip.rt.laws.learned import FINISHED, PLAYS
from micromanip.rt.states import (
    COASTING,
    DRIVER_ERROR,
    FOLLOWING_ERROR,
    INTERLOCK_OPEN,
    RAMPS,
    REFERENCE_LOST,
    SATURATED,
    STRAIN_INVALID,
    TRACKING,
    WARN,
)
from micromanip.settings.check import prepare
from micromanip.settings.tuning_hash import tuning_hash
from tests.cells import simulated

SECONDS = 2.0


class Loop:
    """What `Controller` looks like to the service, in real shared memory; a set is taken as soon as it is handed over.

    As the loop does, it may read the rows whenever the set in force has a number, or an axis still fades.
    """

    def __init__(self, prepared):
        self.prepared = prepared
        self.segments = Segments.create(64, prepared.samples)
        self.control, self.status = self.segments.control.record(CONTROL), self.segments.status.record(STATUS)
        self.words = self.status["words"]
        self.buffers = ParameterBuffers(self.control, self.words, prepared.parameters[0])
        self.added = None
        self.words[w.VERSION_ACTIVE] = prepared.parameters[0]["version"]
        self.cell["state"], self.cell["fault"] = TRACKING, 0
        self.refuses = False

    async def put(self, before):
        """As `Tuning.put_again`."""
        if self.refuses:
            raise CheckFailed("a promoted tuning is on trial")
        rows = self.rows.copy()
        readable = self.numbers.any() or self.axes["level"].any() or (self.axes["why"] == PLAYS).any()
        before()
        assert not readable or (rows == self.rows).all(), "the loop might have read what was half written"
        self.words[w.VERSION_ACTIVE] = self.buffers.put_in_force(self.added(self.prepared, self.prepared.parameters))
        self.buffers.taken()

    @property
    def cell(self):
        return self.status["state"][0]

    @property
    def rows(self):
        return self.segments.sample_table()

    @property
    def axes(self):
        return self.cell["axis"]["learned"]

    @property
    def numbers(self):
        return self.buffers.in_force["axis"]["learned"]["number"]


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    file = tmp_path_factory.mktemp("cell") / "cell.yaml"
    file.write_text(simulated() + f"learning: {{seconds: {SECONDS}}}\n")
    return prepare(file)


@pytest.fixture
def loop(prepared):
    return Loop(prepared)


@pytest.fixture
def service(loop):
    """With what it says and notes."""
    said, noted = [], []

    async def write(changes):
        noted.extend(changes)

    made = LearningService(loop, loop.prepared.configuration.learning, loop.put, write, said.append)
    made.said, made.noted = said, noted
    return made


def show(service, loop, values, number=1, axes="xyz", tool=0, warm_C=None, **changed):
    """As the learning process shows `values` on every axis."""
    rows = np.broadcast_to(values, loop.rows.shape).astype(float)
    service._room.bytes()[:] = np.ascontiguousarray(rows).view(np.uint8).ravel()
    own = loop.prepared.configuration.axes
    hear(service, {
        "shown": hashlib.sha256(rows.tobytes()).hexdigest(), "tool": tool,
        "axes": {name: {"tuning": tuning_hash(own[name]), "generation": number,
                        "temperature_C": (warm_C or {}).get(name)} for name in axes},
        **changed,
    })  # fmt: skip


def hear(service, said):
    asyncio.run(service._hear(said))


def look(service, times=1):
    for _ in range(times):
        asyncio.run(service._look())


def test_a_memory_is_handed_over_while_no_part_is_made_and_the_next_one_once_nothing_fades(service, loop):
    loop.cell["part"], loop.cell["cycle"] = 4, 100
    show(service, loop, 0.25)
    look(service)
    assert not loop.numbers.any(), "a part is being made"
    loop.cell["cycle"] = 2.3 * 10_000  # nobody says that it has ended
    look(service)
    assert loop.numbers.tolist() == [1, 1, 1]
    loop.cell["part"] = 0
    loop.axes["level"][1], loop.axes["why"][:] = 0.5, FINISHED
    show(service, loop, 0.5, 2)
    look(service, 2)
    assert not loop.numbers.any()
    assert (loop.rows == 0.25).all(), "it fades yet"
    loop.axes["level"][1] = 0.0
    look(service)
    assert (loop.rows == 0.5).all()
    assert loop.numbers.tolist() == [2, 2, 2]
    assert not service.said


def test_what_is_refused_now_is_tried_again(service, loop):
    show(service, loop, 0.25)
    loop.refuses = True
    look(service)
    assert not loop.rows.any()
    loop.refuses = False
    look(service)
    assert (loop.rows == 0.25).all()


@pytest.mark.parametrize(
    ("values", "change", "said"),
    [
        (0.1, {"shown": "0"}, []),
        (np.nan, {}, ["axis x: not all of it are numbers"]),
        (5.5, {}, ["axis x: it goes to 5.5 um, learning.limit_um is 5"]),
    ],
)
def test_what_was_half_written_or_is_beyond_its_limit_is_not_taken(service, loop, values, change, said):
    show(service, loop, values, **change)
    look(service)
    assert not loop.rows.any()
    assert not loop.numbers.any()
    assert service.said == [f"WARNING: the correction that was learned is not played: {each}" for each in said]


def test_an_axis_of_another_tuning_is_not_played_and_comes_back_with_its_own(service, loop):
    show(service, loop, 0.1, axes="xy")
    look(service)
    assert loop.numbers.tolist() == [1, 1, 0]
    own, document = loop.prepared, loop.prepared.configuration.model_dump()
    document["axes"]["y"]["inner"]["K_V_per_um"] *= 1.1
    configuration = type(own.configuration).model_validate(document)
    loop.prepared = type(own)(configuration, own.source, own.wiring, own.parameters, own.samples)
    look(service)
    assert loop.numbers.tolist() == [1, 0, 0]
    assert service.status()["axes"]["y"] == {
        "generation": 1, "may_play": False, "state": "idle", "part": None, "apart_um": 0, "last": None,
    }  # fmt: skip
    loop.prepared = own
    look(service)
    assert loop.numbers.tolist() == [1, 1, 0]


def test_a_candidate_has_the_rows_but_no_number(service, loop):
    show(service, loop, 0.1, tool=3)
    look(service)
    assert loop.buffers.in_force["learned_tool"] == 3
    candidate = loop.added(loop.prepared, loop.prepared.parameters, candidate=True)
    assert not candidate[0]["axis"]["learned"]["number"].any()
    assert (candidate[0]["axis"]["learned"]["rows"] > 0).all(), "or what fades would end in a step"
    assert not loop.prepared.parameters[0]["axis"]["learned"]["rows"].any(), "what was compiled is as it was"


def test_reset_ends_what_is_played_at_once_and_until_the_process_has_forgotten_nothing_of_it_is_taken(service, loop):
    show(service, loop, 0.1)
    look(service)
    with pytest.raises(UsageError, match="there is no axis 'w'; there are x, y, z"):
        asyncio.run(service.reset(["w"]))
    loop.cell["part"] = 4  # also while a part is made
    (change,) = asyncio.run(service.reset(["y"]))
    assert change == {"key": "learning.y", "old": 1, "new": None}
    assert loop.numbers.tolist() == [1, 0, 1]
    loop.cell["part"] = 0
    show(service, loop, 0.2, 2)  # on its way meanwhile
    look(service, 2)
    assert loop.numbers.tolist() == [2, 0, 2]
    assert service._forget == {"y": False}, "a process that has died meanwhile is told when it is started again"
    hear(service, {"forgotten": "y", "aside": []})
    assert not service._forget
    show(service, loop, 0.3, 3)
    look(service, 2)
    assert loop.numbers.tolist() == [3, 3, 3]


def faulted(loop, cycle, *faults):
    """The first of `faults`, each a code and an axis, is latched."""
    cell = loop.cell
    cell["fault"], cell["fault_axis"], cell["fault_cycle"] = *faults[0], cycle
    for code, axis in faults:
        note(cell, code, axis, 1.0, 0.5, RAMPS)
        cell["event"]["cycle"][(cell["events"] - 1) % len(cell["event"])] = cycle


def test_what_was_learned_before_a_fault_of_the_axis_is_not_played_any_more_and_kept(service, loop):
    show(service, loop, 0.1)
    look(service)
    faulted(loop, 900, (REFERENCE_LOST, 1))
    look(service)
    assert not service.said, "the tracker's beam is not the axis"
    faulted(loop, 1000, (FOLLOWING_ERROR, 1))
    look(service, 3)
    assert loop.numbers.tolist() == [1, 0, 1]
    (said,) = service.said
    assert said.startswith("axis y had the fault X-213: what was learned of it before is not played any more; it is")
    assert service._forget == {"y": True}
    hear(service, {"forgotten": "y", "aside": ["y.npz.before_fault"]})
    assert service.noted[-1]["new"] == ["y.npz.before_fault"]
    assert service.status()["axes"]["y"]["generation"] is None
    show(service, loop, 0.3, 3)  # learned since
    look(service, 2)
    assert loop.numbers.tolist() == [2, 2, 2]


def test_every_axis_that_faults_in_the_same_cycle_loses_what_was_learned_of_it(service, loop):
    """Though one fault alone is latched, and the loop notes more that are not the axes'."""
    show(service, loop, 0.1)
    look(service)
    faulted(loop, 500, (DRIVER_ERROR, -1), (STRAIN_INVALID, 0))
    look(service)
    assert not service.said, "no axis changes for want of its driver"
    faulted(loop, 900, (STRAIN_INVALID, 1))
    faulted(loop, 1000, (REFERENCE_LOST, 0), (FOLLOWING_ERROR, 2), (INTERLOCK_OPEN, -1), (SATURATED, 0))
    note(loop.cell, COASTING, 1, 1.0, 0.5, WARN)
    look(service, 3)
    assert loop.numbers.tolist() == [0, 1, 0]
    assert [said.split(":")[0] for said in service.said] == ["axis z had the fault X-213", "axis x had the fault X-214"]


def test_another_temperature_than_the_memorys_is_not_played_to_though_nobody_learns_any_more(
    service, loop, monkeypatch
):
    show(service, loop, 0.1, warm_C={"x": 20.0, "y": 23.0})
    for now_C, numbers in (
        (21.0, [1, 1, 1]),
        (22.1, [0, 1, 1]),
        (25.1, [0, 0, 1]),
        (None, [0, 0, 1]),
        (20.0, [1, 0, 1]),
    ):
        monkeypatch.setattr(service, "_temperature_C", lambda now_C=now_C: now_C)
        look(service)
        assert loop.numbers.tolist() == numbers, now_C
