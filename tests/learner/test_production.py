"""A cell that learns while it works, in virtual time: what repeats falls, and nothing that happens makes a step."""

import re

import numpy as np
import pytest

from micromanip.design.learning.law import Update
from micromanip.design.learning.memory import memory_warnings, read_memory
from micromanip.host.learning.handover import FADE_S
from micromanip.rt.laws.learned import BROKEN_OFF, FINISHED, IDLE, OTHER_TOOL, PART_ENDED, PATH_LEFT, WITHDRAWN
from micromanip.rt.states import END_PART, HOLD, TRACKING

from .production import BEGIN_S, LOOP_HZ, Production, text, with_line

pytestmark = pytest.mark.long

SECONDS = 3.0
V_PER_UM = 6.0
"""More than the piezo stacks need and the strain loop adds, slow or fast."""


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """After three parts with noise."""
    made = Production(tmp_path_factory.mktemp("cell"), text(SECONDS))
    made.before_um = made.repeats_um()
    for seed in (1, 2, 3):
        rows, said, found, cell = made.part(seed)
        assert not said
        assert not cell.faults()
        assert all(isinstance(update, Update) for update in found.values()), found
        made.last = rows, found, cell
    return made


@pytest.fixture(scope="module")
def unlearned(tmp_path_factory):
    """The same cell, where nothing has been learned."""
    return Production(tmp_path_factory.mktemp("unlearned"), text(SECONDS))


@pytest.fixture(scope="module")
def uncorrected(unlearned):
    """A part without correction, of seed 8."""
    return unlearned.part(8, learns=False)[0]


def whys(cell):
    return [int(axis["learned"]["why"]) for axis in cell.state[0]["axis"]]


def plays(rows):
    return rows["axis"]["learned_um"] != 0.0


def require_soft(made, rows, without):
    """A correction changes set-point and voltage in a cycle by what itself and its fading do, four times for a loop."""
    played = made.table[: len(made.table) // 2]
    fading = 1.875 / (FADE_S * LOOP_HZ)  # of a minimum jerk, in its middle
    soft_um = 4.0 * (np.abs(np.diff(played, axis=0)).max() + fading * np.abs(played).max())
    assert soft_um < 0.04
    assert (rows["cycle"] == without["cycle"]).all()
    for name, most in (("setpoint_um", soft_um), ("voltage_V", V_PER_UM * soft_um)):
        assert np.abs(np.diff(rows["axis"][name] - without["axis"][name], axis=0)).max() < most, name


def test_what_repeats_falls(learned):
    rows, found, cell = learned.last
    assert whys(cell) == [FINISHED] * 3
    assert plays(rows).any(axis=0).all()
    after_um = learned.repeats_um()
    for axis in ("y", "z"):
        assert after_um[axis] < 0.25 * learned.before_um[axis], (after_um, learned.before_um)
    assert all(update.memory.generation == 3 for update in found.values())


def test_without_a_memory_it_is_the_same_loop_bit_for_bit(uncorrected, tmp_path):
    """As with the parameters and samples of a configuration that knows of no learning."""
    off = Production(tmp_path, text(SECONDS))
    off.handover.added = lambda _, parameters: parameters
    off.table = np.zeros((1, 3))
    assert off.part(8, learns=False)[0].tobytes() == uncorrected.tobytes()


def test_it_begins_and_ends_without_a_step(learned, uncorrected):
    rows = learned.part(8, learns=False)[0]
    assert plays(rows).any()
    require_soft(learned, rows, uncorrected)


def forget_y(cell, made):
    """As `learn reset --axis y` does on a running cell."""
    made.handover.forgotten.add("y")
    made.put(cell)
    made.handover.forgotten.clear()
    return cell.run(0.2)


@pytest.mark.parametrize(
    ("why", "faults", "act"),
    [
        pytest.param(PART_ENDED, (), lambda cell, _: cell.run(0.2, command=END_PART), id="aborted"),
        pytest.param(WITHDRAWN, (), forget_y, id="reset"),
        pytest.param(
            PATH_LEFT,
            ({"channel": "deviation_y", "kind": "offset", "value": 9.0, "at_s": BEGIN_S + 1.5, "for_s": 0.3},),
            lambda cell, _: cell.run(0.2), id="tracker jump",
        ),
        pytest.param(
            PATH_LEFT,
            ({"channel": "deviation_y", "kind": "scale", "value": 1.15, "at_s": BEGIN_S + 1.5},),
            lambda cell, _: cell.run(0.2), id="changed path",
        ),
    ],
)  # fmt: skip
def test_what_ends_it_in_mid_part_makes_no_step(learned, unlearned, uncorrected, why, faults, act):
    """A jump of the tracker moves the set-point by itself: what the correction adds to that is what counts."""
    changed_path = any(each["kind"] == "scale" for each in faults)
    generation = learned.store.of_tool(0)["y"].generation
    rows, said, found, cell = learned.part(
        8, faults=faults, meanwhile=lambda cell: act(cell, learned), learns=changed_path
    )
    assert whys(cell)[1] == why
    assert not plays(rows)[-LOOP_HZ:, 1].any() or why == WITHDRAWN
    assert cell.state[0]["state"] == TRACKING
    require_soft(learned, rows, unlearned.part(8, learns=False, faults=faults)[0] if faults else uncorrected)
    if why == PART_ENDED:
        assert said == ["part 1 was not finished, it ended after 1.50 s: nothing is learned from it"]
    if changed_path:
        assert "axis y follows another path than its memory's" in str(found["y"])
        assert learned.store.of_tool(0)["y"].generation == generation


def test_a_hold_in_mid_part_fades_it_out_and_it_is_not_resumed(learned):
    rows, said, found, cell = learned.part(9, meanwhile=lambda cell: cell.run(0.2, command=HOLD))
    assert whys(cell) in ([BROKEN_OFF] * 3, [PART_ENDED] * 3)
    assert not plays(rows)[-LOOP_HZ:].any()
    assert len(said) == 1
    assert not found


def made_for(seconds):
    return {"channel": "retracted", "kind": "value", "value": 17.0, "at_s": BEGIN_S, "for_s": seconds}


def test_a_line_says_to_the_cycle_when_a_part_begins_and_when_it_is_broken_off(tmp_path):
    made, faults = Production(tmp_path, with_line(SECONDS, "part", "retracted")), made_for(SECONDS + 0.5)
    for seed in (1, 2, 3):
        rows, said, found, cell = made.part(seed, faults=[faults])
        assert not said
        assert all(isinstance(update, Update) for update in found.values()), found
    assert whys(cell) == [FINISHED] * 3
    assert cell.state[0]["parts"] == 1
    first = rows["cycle"][int(np.argmax(plays(rows)[:, 1]))]
    assert 0 <= first - cell.state[0]["axis"][1]["learned"]["part"] <= 1, "the first row may be 0"
    _, said, _, cell = made.part(3, faults=[{**faults, "for_s": 1.0}])
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
    assert made.store.forget("y", keep=False) == []
    assert not file.exists()
    assert set(made.part(1)[2]) == {"x", "y", "z"}, "it learns again"


def tool_three(at_s):
    return {"channel": "interlock", "kind": "value", "value": 3.0, "at_s": at_s, "for_s": 60.0}


def test_a_tool_has_a_memory_of_its_own_and_another_one_ends_it_softly(tmp_path_factory):
    made = Production(tmp_path_factory.mktemp("tools"), with_line(SECONDS, "tool", "interlock"))
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
    assert [(each.tool, each.parts) for each in kept] == [(1, 2), (3, 1)]

    changes = [tool_three(BEGIN_S + 1.5)]
    rows, said, found, cell = made.part(8, faults=changes)
    assert whys(cell) == [OTHER_TOOL] * 3, "that of tool 1 was played again"
    assert not plays(rows)[-LOOP_HZ:].any()
    assert said == ["part 1 was not finished, the tool was changed after 1.50 s: nothing is learned from it"]
    assert not found
    none = Production(tmp_path_factory.mktemp("none"), with_line(SECONDS, "tool", "interlock"))
    require_soft(made, rows, none.part(8, faults=changes, learns=False)[0])
