"""Which memory an axis goes by: of the tool in the spindle, near the temperature; the others are kept."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.design.learning.memory import Learned, Memory, memory_file, memory_files
from micromanip.learner.shelf import UNKNOWN, Conditions, Shelf

FOLDER, WITHIN_K = Path("learned"), 2.0


def memory(tool=0, temperature_C=None):
    return Memory("c", "y", "t", 1000.0, 0.0, np.zeros(9), Learned.nothing(9), tool=tool, temperature_C=temperature_C)


def shelf(*memories):
    found = Shelf(FOLDER, "y", WITHIN_K)
    for each in memories:
        found.put(memory_file(FOLDER, "y", each.tool, each.temperature_C), each)
    return found


def test_the_tool_that_is_back_has_its_memory_again():
    kept = shelf(memory(tool=3), memory(tool=5))
    file, found = kept.fitting(Conditions(3))
    assert (file.name, found.tool) == ("y.tool3.npz", 3)
    assert kept.fitting(Conditions(4)) == (FOLDER / "y.tool4.npz", None)
    assert kept.fitting(Conditions(0)) == (FOLDER / "y.npz", None)
    assert kept.fitting(Conditions(3))[1] is found
    assert kept.fitting(Conditions(UNKNOWN))[1] is None


def test_of_several_temperatures_the_nearest_counts_and_beyond_its_reach_none():
    kept = shelf(memory(temperature_C=20.0), memory(temperature_C=23.0))
    for now_C, goes_by in ((20.4, 20.0), (21.9, 20.0), (22.1, 23.0), (21.1, 23.0), (25.1, None), (17.9, None)):
        found = kept.fitting(Conditions(0, now_C))[1]
        assert (None if found is None else found.temperature_C) == goes_by, now_C
    assert kept.fitting(Conditions(0, 25.1))[0].name == "y.25.1C.npz"
    assert kept.fitting(Conditions(0, None, unmeasured=True))[1] is None
    assert kept.fitting(Conditions(0, None))[1] is None, "what was learned at a temperature needs one"


@given(
    st.lists(st.tuples(st.integers(0, 3), st.floats(-20.0, 60.0)), max_size=6),
    st.lists(st.tuples(st.integers(-1, 3), st.none() | st.floats(-20.0, 60.0)), min_size=1, max_size=12),
)
def test_whatever_comes_nothing_is_gone_by_that_does_not_fit_and_nothing_is_written_over(kept, course):
    found = shelf(*(memory(*each) for each in kept))
    taken = {memory_file(FOLDER, "y", *each) for each in kept}
    for tool, now_C in course:
        file, memory_now = found.fitting(Conditions(tool, now_C, unmeasured=now_C is None))
        if memory_now is None:
            assert file not in taken or tool == UNKNOWN or now_C is None
            continue
        assert memory_now.tool == tool
        assert abs(memory_now.temperature_C - now_C) <= WITHIN_K


def test_the_files_of_an_axis_are_its_own_and_not_what_was_put_aside(tmp_path):
    ours = {"y.npz", "y.tool3.npz", "y.tool3.-4.5C.npz", "y.22.0C.npz"}
    for name in (*ours, "z.npz", "yy.npz", "y.npz.before_fault", "y.old.npz", ".y.npz.0f.part"):
        (tmp_path / name).touch()
    assert {file.name for file in memory_files(tmp_path, "y")} == ours


@pytest.mark.parametrize(
    ("now", "told"),
    [
        (Conditions(3, 22.04), "tool 3, 22.0 degC"),
        (Conditions(), "no tool was told"),
        (Conditions(UNKNOWN, 20.0), "the signal tool names no tool"),
        (Conditions(2, None, unmeasured=True), "the signal temperature has no usable value"),
    ],
)
def test_conditions_are_told(now, told):
    assert str(now) == told
