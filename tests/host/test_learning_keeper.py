"""Memories on their way into the loop: taken as they were shown, and written while the loop can read none."""

import asyncio
import hashlib

import numpy as np
import pytest

from micromanip.errors import CheckFailed, UsageError
from micromanip.host.learning.keeper import LearningKeeper
from micromanip.host.parameter_buffers import ParameterBuffers
from micromanip.host.shared_memory import CONTROL, STATUS, Segments
from micromanip.rt import mailbox as w
from micromanip.rt.faults import note
from micromanip.rt.laws.learned import FINISHED, PATH_LEFT, PLAYS
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
from micromanip.settings.commissioned import tuning_hash
from tests.cells import simulated

SECONDS = 2.0


class Loop:
    """What `Controller` looks like to the keeper, with real shared memory; a set is taken as soon as it is handed over.

    As the loop does, it may read the rows whenever the set in force has a number, or an axis still fades.
    """

    def __init__(self, prepared):
        self.prepared = prepared
        self.segments = Segments.create(64, prepared.samples)
        self.control, self.status = self.segments.control.record(CONTROL), self.segments.status.record(STATUS)
        self.words = self.status["words"]
        self.buffers = ParameterBuffers(self.control, self.words, prepared.parameters[0])
        self.added = None
        self.words[w.VERSION_ACTIVE], self.words[w.STATE] = prepared.parameters[0]["version"], TRACKING
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
    def rows(self):
        return self.segments.sample_table()

    @property
    def axes(self):
        return self.status["state"][0]["axis"]["learned"]

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
def kept(loop):
    """The keeper, with what it says and notes."""
    said, noted = [], []

    async def note(changes):
        noted.extend(changes)

    keeper = LearningKeeper(loop, loop.prepared.configuration.learning, loop.put, note, said.append)
    keeper.said, keeper.noted = said, noted
    return keeper


def shown(keeper, loop, values, number=1, axes="xyz", tuning=None):
    """What the learning process shows: `values` on every axis."""
    rows = np.broadcast_to(values, loop.rows.shape).astype(float)
    keeper._room.bytes()[:] = np.ascontiguousarray(rows).view(np.uint8).ravel()
    own = loop.prepared.configuration.axes
    return {
        "staged": number, "sha256": hashlib.sha256(rows.tobytes()).hexdigest(),
        "axes": {name: {"tuning": tuning or tuning_hash(own[name]), "generation": number} for name in axes},
    }  # fmt: skip


def hear(keeper, loop, said):
    asyncio.run(keeper._hear(said))


def look(keeper, loop):
    cell = loop.status["state"][0]
    asyncio.run(keeper._playing.put_in_force(cell, cell["axis"]["learned"]))


def test_a_memory_is_handed_over_while_no_part_is_made_and_the_next_one_once_nothing_fades(kept, loop):
    loop.status["state"][0]["part"], loop.status["state"][0]["cycle"] = 4, 100
    hear(kept, loop, shown(kept, loop, 0.25))
    look(kept, loop)
    assert not loop.numbers.any(), "a part is being made"
    loop.status["state"][0]["cycle"] = 2.3 * 10_000  # nobody says that it has ended
    look(kept, loop)
    assert loop.numbers.tolist() == [1, 1, 1]
    loop.status["state"][0]["part"] = 0
    assert (loop.rows == 0.25).all()
    loop.axes["level"][1], loop.axes["why"][:] = 0.5, FINISHED
    hear(kept, loop, shown(kept, loop, 0.5, 2))
    look(kept, loop)
    assert not loop.numbers.any()
    assert (loop.rows == 0.25).all(), "it fades yet"
    look(kept, loop)
    assert (loop.rows == 0.25).all()
    loop.axes["level"][1] = 0.0
    look(kept, loop)
    assert (loop.rows == 0.5).all()
    assert loop.numbers.tolist() == [2, 2, 2]
    look(kept, loop)
    assert loop.buffers.in_force["version"] == loop.words[w.VERSION_ACTIVE]
    assert not kept.said


def test_what_is_refused_now_is_tried_again(kept, loop):
    hear(kept, loop, shown(kept, loop, 0.25))
    loop.refuses = True
    with pytest.raises(CheckFailed, match="on trial"):
        look(kept, loop)
    assert not loop.rows.any()
    loop.refuses = False
    look(kept, loop)
    assert (loop.rows == 0.25).all()


@pytest.mark.parametrize(
    ("values", "change", "message"),
    [
        (0.1, {"sha256": "0"}, "it is not what the learning process wrote"),
        (np.nan, {}, "axis x: not all of it are numbers"),
        (5.5, {}, "axis x: it goes to 5.5 um, learning.limit_um is 5"),
    ],
)
def test_what_was_half_written_or_is_beyond_its_limit_is_not_taken(kept, loop, values, change, message):
    hear(kept, loop, shown(kept, loop, values) | change)
    look(kept, loop)
    assert not loop.rows.any()
    assert not loop.numbers.any()
    assert kept.said == [f"WARNING: the correction that was learned is not played: {message}"]


def test_an_axis_of_another_tuning_is_not_played_and_comes_back_with_its_own(kept, loop):
    hear(kept, loop, shown(kept, loop, 0.1, axes="xy"))
    look(kept, loop)
    assert loop.numbers.tolist() == [1, 1, 0]
    own, document = loop.prepared, loop.prepared.configuration.model_dump()
    document["axes"]["y"]["inner"]["K_V_per_um"] *= 1.1
    configuration = type(own.configuration).model_validate(document)
    loop.prepared = type(own)(configuration, own.source, own.wiring, own.parameters, own.samples)
    look(kept, loop)
    assert loop.numbers.tolist() == [1, 0, 0]
    assert kept.status()["axes"]["y"] | {"apart_um": 0} == {
        "generation": 1, "may_play": False, "state": "idle", "part": None, "apart_um": 0, "last": None,
    }  # fmt: skip
    loop.prepared = own
    look(kept, loop)
    assert loop.numbers.tolist() == [1, 1, 0]


def test_a_candidate_has_the_rows_but_no_number(kept, loop):
    hear(kept, loop, shown(kept, loop, 0.1))
    look(kept, loop)
    candidate = kept._correction.added(loop.prepared, loop.prepared.parameters, candidate=True)
    learned = candidate[0]["axis"]["learned"]
    assert not learned["number"].any()
    assert (learned["rows"] > 0).all(), "or what fades would end in a step"
    assert not loop.prepared.parameters[0]["axis"]["learned"]["rows"].any(), "what was compiled is as it was"


def test_reset_takes_it_away_and_forgets(kept, loop):
    hear(kept, loop, shown(kept, loop, 0.1))
    look(kept, loop)
    with pytest.raises(UsageError, match="there is no axis w; the axes are x, y, z"):
        asyncio.run(kept.reset(["w"]))
    changes = asyncio.run(kept.reset(["y"]))
    assert [(each["key"], each["old"], each["new"]) for each in changes] == [("learning.y", 1, None)]
    assert not loop.numbers.any()
    assert (loop.rows == 0.1).all()
    assert kept._forget == {"y"}, "a process that has died meanwhile is told when it is started again"
    hear(kept, loop, {"forgotten": ["y"]})
    assert not kept._forget


def test_what_ends_early_is_told_once_for_all_axes_and_its_refusal_is_only_noted(kept, loop):
    loop.status["state"][0]["parts"], loop.axes["apart_um"][2], loop.axes["part"][:] = 3, 6.25, 30_000
    for whys in ([PLAYS, PLAYS, PLAYS], [PLAYS, PATH_LEFT, PATH_LEFT], [PLAYS, PATH_LEFT, PATH_LEFT]):
        loop.axes["why"][:] = whys
        asyncio.run(kept._playing._tell_ends(["x", "y", "z"], loop.axes))
    loop.status["state"][0]["parts"] = 4  # the next has begun, and nothing is played in it yet
    asyncio.run(kept._playing._tell_ends(["x", "y", "z"], loop.axes))
    (said,) = kept.said
    assert said == (
        "part 3: the learned correction of axis y, z has faded out: the reference is 6.25 um from the path that was "
        "learned, 5 um may be"
    )
    hear(kept, loop, {"part": 3, "learned": {}, "refused": {"y": "another path", "x": "too late"}})
    assert kept.said[1:] == ["WARNING: too late"]
    assert [each["key"] for each in kept.noted] == ["learning.y", "learning.z", "learning.y", "learning.x"]


def faulted(loop, cycle, *faults):
    """The first of `faults`, each a code and an axis, is latched."""
    cell = loop.status["state"][0]
    cell["fault"], cell["fault_axis"], cell["fault_cycle"] = *faults[0], cycle
    for code, axis in faults:
        note(cell, code, axis, 1.0, 0.5, RAMPS)
        cell["event"]["cycle"][(cell["events"] - 1) % len(cell["event"])] = cycle


def drops(kept, loop):
    asyncio.run(kept._playing._drop_faulty(["x", "y", "z"], loop.status["state"][0]))


def test_what_was_learned_before_a_fault_of_the_axis_is_not_played_any_more_and_said_once(kept, loop):
    hear(kept, loop, shown(kept, loop, 0.1))
    look(kept, loop)
    faulted(loop, 900, (REFERENCE_LOST, 1))
    drops(kept, loop)
    assert not kept.said, "the tracker's beam is not the axis"
    faulted(loop, 1000, (FOLLOWING_ERROR, 1))
    for _ in range(3):
        drops(kept, loop)
    look(kept, loop)
    assert loop.numbers.tolist() == [1, 0, 1]
    (said,) = kept.said
    assert said.startswith(
        "axis y had the fault X-213: what was learned of it before is not played any more; it is kept"
    )
    assert [each["key"] for each in kept.noted] == ["learning.y"]
    hear(kept, loop, shown(kept, loop, 0.2, 2))  # on its way when the fault came
    look(kept, loop)
    look(kept, loop)
    assert loop.numbers.tolist() == [2, 0, 2]
    hear(kept, loop, {"aside": ["y"], "files": ["y.npz.before_fault.2"]})
    assert (kept.noted[-1]["old"], kept.noted[-1]["new"]) == ("y.npz", "y.npz.before_fault.2")
    look(kept, loop)
    assert kept.status()["axes"]["y"]["generation"] is None
    hear(kept, loop, shown(kept, loop, 0.3, 3))  # learned since
    look(kept, loop)
    look(kept, loop)
    assert loop.numbers.tolist() == [3, 3, 3]


def test_every_axis_that_faults_in_the_same_cycle_loses_what_was_learned_of_it(kept, loop):
    """Though one fault alone is latched, and the loop tells of more that are not the axes'."""
    hear(kept, loop, shown(kept, loop, 0.1))
    look(kept, loop)
    faulted(loop, 500, (DRIVER_ERROR, -1), (STRAIN_INVALID, 0))
    drops(kept, loop)
    assert not kept.said, "no axis changes for want of its driver"
    faulted(loop, 900, (STRAIN_INVALID, 1))
    faulted(loop, 1000, (REFERENCE_LOST, 0), (FOLLOWING_ERROR, 2), (INTERLOCK_OPEN, -1), (SATURATED, 0))
    note(loop.status["state"][0], COASTING, 1, 1.0, 0.5, WARN)
    for _ in range(3):
        drops(kept, loop)
    look(kept, loop)
    assert loop.numbers.tolist() == [0, 1, 0]
    assert [said.split(":")[0] for said in kept.said] == ["axis z had the fault X-213", "axis x had the fault X-214"]


def test_another_temperature_than_the_memorys_is_not_played_to_though_nobody_learns_any_more(kept, loop):
    said = shown(kept, loop, 0.1)
    said["axes"]["x"]["temperature_C"], said["axes"]["y"]["temperature_C"] = 20.0, 23.0
    hear(kept, loop, said)
    for now_C, numbers in (
        (21.0, [1, 1, 1]),
        (22.1, [0, 1, 1]),
        (25.1, [0, 0, 1]),
        (None, [0, 0, 1]),
        (20.0, [1, 0, 1]),
    ):
        kept._correction.temperature_C = now_C
        look(kept, loop)
        assert loop.numbers.tolist() == numbers, now_C


def test_a_tool_that_is_stated_is_in_the_set_that_the_loop_runs_on_before_the_part_begins(kept, loop):
    hear(kept, loop, shown(kept, loop, 0.1) | {"tool": 3})
    look(kept, loop)
    assert (loop.buffers.in_force["learned_tool"], loop.buffers.in_force["stated_tool"]) == (3, 0)
    (changed,) = asyncio.run(kept.state_tool(5))
    assert (changed["key"], changed["old"], changed["new"]) == ("learning.tool", 0, 5)
    assert loop.buffers.in_force["stated_tool"] == 5
    assert asyncio.run(kept.state_tool(5)) == []
    loop.refuses = True
    with pytest.raises(CheckFailed, match="on trial"):
        asyncio.run(kept.state_tool(3))
    assert kept._correction.stated_tool == 5


def test_what_is_of_another_tool_than_the_part_changes_while_it_is_made(kept, loop):
    hear(kept, loop, shown(kept, loop, 0.1) | {"tool": 3})
    look(kept, loop)
    cell = loop.status["state"][0]
    cell["part"], cell["cycle"], cell["tool"] = 4, 100, 5
    hear(kept, loop, shown(kept, loop, 0.2, 2) | {"tool": 5})
    look(kept, loop)
    look(kept, loop)
    assert (loop.rows == 0.2).all()
    assert loop.buffers.in_force["learned_tool"] == 5
    hear(kept, loop, shown(kept, loop, 0.3, 3) | {"tool": 5})
    look(kept, loop)
    assert (loop.rows == 0.2).all(), "now it is that of the part, which is being made"
