"""A cell that learns while it works, in virtual time: what repeats falls, and nothing that happens makes a step."""

import re
import resource

import numpy as np
import pytest

from micromanip.control.learned import FADE_S
from micromanip.design.learning.law import Update
from micromanip.design.learning.memory import read_memory, write_memory
from micromanip.design.learning.usable import memory_warnings
from micromanip.errors import CheckFailed
from micromanip.rt.laws.learned import BROKEN_OFF, FINISHED, IDLE, OTHER_TOOL, PART_ENDED, PATH_LEFT, WITHDRAWN
from micromanip.rt.states import END_PART, HOLD, TRACKING
from micromanip.rt.telemetry import LEARNED_PLAYS

from .production import BEGIN_S, LOOP_HZ, Production, text

pytestmark = pytest.mark.long

SECONDS = 3.0
V_PER_UM = 6.0
"""More than the piezo stacks need and the strain loop adds, slow or fast."""
KNOWN_S = 1.2
"""Then the path has said where in the part it is, and the correction is there in full."""


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """After three parts, with what the first left over that repeats."""
    made = Production(tmp_path_factory.mktemp("cell"), text(SECONDS))
    made.before_um = made.repeats_um(from_s=KNOWN_S)
    for seed in (1, 2, 3):
        rows, said, found, cell = made.part(seed)
        assert not said
        assert not cell.faults()
        assert all(isinstance(update, Update) for update in found.values()), found
        made.last = rows, found, cell
    return made


def whys(cell):
    return [int(axis["learned"]["why"]) for axis in cell.state[0]["axis"]]


def softly_um(made):
    """What a correction may change the set-point by in a cycle: by itself and by fading, four times for the loop."""
    played = made.table[: len(made.table) // 2]
    fading = 1.875 / (FADE_S * LOOP_HZ)  # of a minimum jerk, in its middle
    return 4.0 * (np.abs(np.diff(played, axis=0)).max() + fading * np.abs(played).max())


def plays(rows):
    return (rows["axis"]["fresh"] & LEARNED_PLAYS) != 0


def steps(rows, without):
    """Largest change per cycle (axes,) that the correction has brought into set-point and voltage."""
    assert (rows["cycle"] == without["cycle"]).all()
    return [
        np.abs(np.diff(rows["axis"][name] - without["axis"][name], axis=0)).max(axis=0)
        for name in ("setpoint_um", "voltage_V")
    ]


@pytest.fixture(scope="module")
def unlearned(tmp_path_factory):
    """The same cell, where nothing has been learned."""
    return Production(tmp_path_factory.mktemp("unlearned"), text(SECONDS))


@pytest.fixture(scope="module")
def uncorrected(unlearned):
    """A part without correction, of seed 8."""
    return unlearned.part(8, learns=False, meanwhile=lambda cell: [cell.run(0.2)])[0]


def test_what_repeats_falls_and_the_path_says_when_a_part_began(learned):
    rows, found, cell = learned.last
    assert whys(cell) == [FINISHED] * 3
    states = cell.state[0]["axis"]["learned"]
    assert np.abs(states["begun_cycle"] - states["part"]).max() <= 10, "to a millisecond"
    assert plays(rows).any(axis=0).all()
    after_um = learned.repeats_um(from_s=KNOWN_S)
    for axis in ("y", "z"):
        assert after_um[axis] < 0.25 * learned.before_um[axis], (after_um, learned.before_um)
    assert all(update.memory.generation == 3 for update in found.values())


def test_without_a_memory_it_is_the_same_loop_bit_for_bit(uncorrected, tmp_path):
    """As with the parameters and samples of a configuration that knows of no learning."""
    off = Production(tmp_path, text(SECONDS))
    off.correction.added = lambda _, parameters: parameters
    off.table = np.zeros((1, 3))
    rows = off.part(8, learns=False, meanwhile=lambda cell: [cell.run(0.2)])[0]
    assert rows.tobytes() == uncorrected.tobytes()


def test_it_begins_and_ends_without_a_step(learned, uncorrected):
    soft_um = softly_um(learned)
    assert soft_um < 0.03
    rows = learned.part(8, learns=False, meanwhile=lambda cell: [cell.run(0.2)])[0]
    um, volts = steps(rows, uncorrected)
    assert plays(rows).any()
    assert um.max() < soft_um
    assert volts.max() < V_PER_UM * soft_um


@pytest.mark.parametrize(
    ("why", "faults", "act"),
    [
        pytest.param(PART_ENDED, (), lambda cell, _: cell.run(0.2, command=END_PART), id="aborted"),
        pytest.param(WITHDRAWN, (), lambda cell, made: _withdraw(cell, made), id="reset"),
        pytest.param(
            PATH_LEFT,
            ({"channel": "deviation_y", "kind": "offset", "value": 9.0, "at_s": BEGIN_S + 1.5, "for_s": 0.3},),
            lambda cell, _: cell.run(0.2), id="tracker jump",
        ),
        pytest.param(
            PATH_LEFT,
            ({"channel": "deviation_y", "kind": "scale", "value": 1.1, "at_s": BEGIN_S + 1.5},),
            lambda cell, _: cell.run(0.2), id="changed path",
        ),
    ],
)  # fmt: skip
def test_what_ends_it_in_mid_part_makes_no_step(learned, unlearned, uncorrected, why, faults, act):
    """A jump of the tracker moves the set-point by itself: what the correction adds to that is what counts."""

    def meanwhile(cell):
        return [act(cell, learned)]

    soft_um, changed_path = softly_um(learned), any(each["kind"] == "scale" for each in faults)
    number, generations = learned.correction.number, dict(learned.correction.memories.generations)
    rows, said, found, cell = learned.part(8, faults=faults, meanwhile=meanwhile, learns=changed_path)
    learned.correction.number = number
    assert whys(cell)[1] == why
    assert not plays(rows)[-LOOP_HZ:, 1].any()
    assert cell.state[0]["state"] == TRACKING
    without = uncorrected
    if faults:
        without = unlearned.part(8, learns=False, faults=faults, meanwhile=lambda cell: [cell.run(0.2)])[0]
    um, volts = steps(rows, without)
    assert um.max() < soft_um
    assert volts.max() < V_PER_UM * soft_um
    if why == PART_ENDED:
        assert len(said) == 1
        assert "was not finished, it ended after 1.50 s" in said[0]
    if changed_path:
        assert "axis y follows another path than its memory's" in str(found["y"])
    assert learned.memories.known["y"].generation == generations["y"] or why == WITHDRAWN


def _withdraw(cell, made):
    """As `learn reset` does on a running cell."""
    made.correction.withdraw()
    made.put(cell)
    return cell.run(0.2)


def test_a_hold_in_mid_part_fades_it_out_and_it_is_not_resumed(learned):
    rows, said, found, cell = learned.part(9, meanwhile=lambda cell: [cell.run(0.2, command=HOLD)])
    assert whys(cell) == [BROKEN_OFF] * 3 or whys(cell) == [PART_ENDED] * 3
    assert not plays(rows)[-LOOP_HZ:].any()
    assert len(said) == 1
    assert not found


def wired(seconds):
    """With a machine that says when a part is made: by the line that a scheduled fault can lead."""
    changes = (
        ("    force: {start_s: 2.0,", "    lines: {}\n    force: {start_s: 2.0,"),
        ("  true_strain_x:", "  part: {driver: cell, channel: retracted}\n  true_strain_x:"),
    )
    return text(seconds, *changes) + "switches: {amplifier_enable: {driver: cell}}\n"


def running(seconds):
    return {"channel": "retracted", "kind": "value", "value": 17.0, "at_s": BEGIN_S, "for_s": seconds}


@pytest.mark.thorough  # whole parts, and five of them, where two of three seconds show the same
def test_by_the_fifth_part_hardly_anything_repeats(tmp_path):
    made = Production(tmp_path, wired(8.0))
    runs = [running(8.5)]
    before_um = made.repeats_um(faults=runs)
    for seed in range(1, 6):
        made.part(seed, faults=runs)
    after_um = made.repeats_um(faults=runs)
    assert max(after_um.values()) < 0.05
    assert after_um["y"] < 0.25 * before_um["y"]
    assert after_um["z"] < 0.25 * before_um["z"]


def test_a_line_says_to_the_cycle_when_a_part_begins_and_when_it_is_broken_off(learned, tmp_path):
    made = Production(tmp_path, wired(SECONDS))
    assert made.memories.search_s == 0.0
    runs = running(SECONDS + 0.5)
    for seed in (1, 2):
        _, said, found, cell = made.part(seed, faults=[runs])
        assert not said
        assert all(isinstance(update, Update) for update in found.values()), found
    assert cell.state[0]["parts"] == 1
    rows, _, _, cell = made.part(3, faults=[runs], learns=False)
    assert whys(cell) == [FINISHED] * 3
    first = int(np.argmax(plays(rows)[:, 1]))
    assert rows["cycle"][first] == cell.state[0]["axis"][1]["learned"]["part"]
    rows, said, _, cell = made.part(3, faults=[{**runs, "for_s": 1.0}])
    assert whys(cell) == [PART_ENDED] * 3
    assert len(said) == 1


def test_what_lies_in_the_folder_and_is_not_of_this_cell_says_so_once_and_is_not_played(learned, tmp_path):
    (tmp_path / "learned").mkdir()
    file, whole = tmp_path / "learned" / "y.npz", (learned.file.parent / "learned" / "y.npz").read_bytes()
    tuning, cell = text(SECONDS).split("\n  y:\n"), text(SECONDS).replace("rate_Hz: 1000.0,", "rate_Hz: 500.0,")
    gain = re.sub(r"K_V_per_um: [0-9.]+", "K_V_per_um: 0.25", tuning[1], count=1)
    for content, cell_text, message in (
        (whole[: len(whole) // 2], text(SECONDS), "or a damaged one"),
        (b"", text(SECONDS), "or a damaged one"),
        (whole, f"{tuning[0]}\n  y:\n{gain}", "of tuning"),
        (whole, cell, "of cell"),
        (whole, text(4.0), "is of a part of 3 s, learning.seconds says 4"),
    ):
        file.write_bytes(content)
        made = Production(tmp_path, cell_text)
        (said,) = made.said
        assert message in said
        assert said.endswith("nothing is learned or played of axis y")
        (warned,) = memory_warnings(made.prepared.configuration, file.parent)
        assert warned.replace("would be", "is") == said
    _, _, _, cell = made.part(1, learns=False)
    assert whys(cell) == [IDLE] * 3


def tooled(seconds):
    """With a machine that says which tool it is, 1 but for scheduled faults."""
    changes = (
        ("    force: {start_s: 2.0,", "    lines: {}\n    force: {start_s: 2.0,"),
        ("  true_strain_x:", "  tool: {driver: cell, channel: interlock}\n  true_strain_x:"),
    )
    return text(seconds, *changes) + "switches: {amplifier_enable: {driver: cell}}\n"


def tool_three(at_s):
    return {"channel": "interlock", "kind": "value", "value": 3.0, "at_s": at_s, "for_s": 60.0}


def test_a_tool_has_a_memory_of_its_own_and_another_one_ends_it_softly(tmp_path_factory):
    made = Production(tmp_path_factory.mktemp("tools"), tooled(SECONDS))
    for seed in (1, 2):
        _, said, found, _ = made.part(seed)
        assert not said
        assert all(isinstance(update, Update) for update in found.values()), found
    rows, said, found, cell = made.part(3, faults=[tool_three(0.0)])
    assert whys(cell) == [IDLE] * 3
    assert not plays(rows).any()
    folder = made.file.parent / "learned"
    assert {file.name for file in folder.iterdir()} == {f"{axis}.tool{tool}.npz" for axis in "xyz" for tool in (1, 3)}
    kept = [read_memory(folder / f"y.tool{tool}.npz") for tool in (1, 3)]
    assert [(each.tool, each.now.parts) for each in kept] == [(1, 2), (3, 1)]

    changes = [tool_three(BEGIN_S + 1.5)]
    rows, said, found, cell = made.part(8, faults=changes)
    assert whys(cell) == [OTHER_TOOL] * 3, "that of tool 1 was played again"
    assert not plays(rows)[-LOOP_HZ:].any()
    assert said == ["part 1 was not finished, the tool was changed after 1.50 s: nothing is learned from it"]
    assert not found
    without = Production(tmp_path_factory.mktemp("none"), tooled(SECONDS)).part(8, faults=changes, learns=False)[0]
    um, volts = steps(rows, without)
    assert um.max() < softly_um(made)
    assert volts.max() < V_PER_UM * softly_um(made)


def test_what_moves_away_is_said_once_and_taken_up_again(learned):
    told = [learned.memories.move_to(learned.memories.conditions(tool, None)) for tool in (0, 4, 4, 0, 0)]
    away = "tool 4 instead of no tool was told: axis x, y, z has no memory of that: plays nothing, learns anew"
    back = "no tool was told instead of tool 4: axis x, y, z goes by what was learned then"
    kept = "; the other memories are kept"
    assert told == [None, away + kept, None, back + kept, None]


def test_a_full_disk_leaves_what_was_played_before(learned):
    """A limit of the size of files, which every user can have, stands for it."""
    folder = learned.file.parent / "learned"
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    known = learned.memories.known
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("micromanip.learner.memories.write_memory", _limited)
        _, _, found, cell = learned.part(11)
    assert whys(cell) == [FINISHED] * 3
    assert all(isinstance(problem, CheckFailed) and "File too large" in str(problem) for problem in found.values())
    assert len(found) == 3
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
    assert {name: each.generation for name, each in learned.memories.known.items()} == {
        name: each.generation for name, each in known.items()
    }


def _limited(file, memory):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        write_memory(file, memory)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
