"""What was learned before a fault goes out of the way, whatever state the folder is in."""

import numpy as np
import pytest

from micromanip.design.learning.memory import Learned, Memory, memory_file
from micromanip.learner.memories import Memories
from micromanip.learner.shelf import Conditions
from micromanip.settings.check import prepare

from .production import text


@pytest.fixture
def kept(tmp_path):
    """Memories of a cell in whose folder stands a damaged one of y."""
    (tmp_path / "cell.yaml").write_text(text(3.0))
    configuration = prepare(tmp_path / "cell.yaml").configuration
    folder = tmp_path / "learned"
    folder.mkdir()
    memory_file(folder, "y").write_bytes(b"not one")
    return Memories(configuration, configuration.learning, folder), folder


def test_an_axis_whose_memory_was_damaged_learns_anew_once_it_is_aside(kept):
    memories, _ = kept
    (said,) = memories.read()
    assert said.endswith("nothing is learned or played of axis y")
    assert memories.put_aside(["y"]) == (["y.npz.before_fault"], {})
    assert not list(memories.read())
    assert "y" not in memories._barred


def test_each_fault_leaves_what_was_learned_before_it_and_so_many_do_not_fill_the_disk(kept):
    memories, folder = kept
    memories.put_aside(["y"])
    for since in range(12):
        memory_file(folder, "y").write_bytes(b"%d" % since)
        ((name,), problems) = memories.put_aside(["y"])
        assert not problems
        assert (folder / name).read_bytes() == b"%d" % since
    found = {file.read_bytes() for file in folder.iterdir()}
    assert found == {b"not one", *(b"%d" % since for since in (*range(7), 11))}


def test_one_that_cannot_be_put_aside_is_not_gone_by_and_does_not_keep_the_others(kept, monkeypatch):
    memories, folder = kept
    memory_file(folder, "y", 3).write_bytes(b"of a tool")
    memory_file(folder, "z").write_bytes(b"of z")
    monkeypatch.setattr("micromanip.design.learning.memory._MOST_ASIDE", 1)
    (folder / "y.npz.before_fault").mkdir()
    files, problems = memories.put_aside(["y", "z"])
    assert files == ["y.tool3.npz.before_fault", "z.npz.before_fault"]
    assert list(problems) == ["y"]
    assert memories._barred == {"y"}


def test_a_tool_that_is_back_is_told_instead_of_the_one_before_it(kept):
    memories, folder = kept
    one = Memory("c", "z", "t", 1000.0, 0.0, np.zeros(9), Learned.nothing(9), tool=1)
    memories._shelves["z"].put(memory_file(folder, "z", 1), one)
    told = [memories.move_to(Conditions(tool)) for tool in (1, 2, 3, 1)]
    assert told[1].startswith("tool 2 instead of tool 1: axis z has no memory of that")
    assert told[2] is None
    assert told[3].startswith("tool 1 instead of tool 3: axis z goes by what was learned then")
