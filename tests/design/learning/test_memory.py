"""The file of a memory: what was written is read, whole or not at all, and nothing else passes for one."""

import json
import multiprocessing
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.design.learning.memory import (
    Learned,
    Memory,
    cell_name,
    memory_file,
    memory_files,
    read_memory,
    write_memory,
)
from micromanip.errors import CheckFailed
from micromanip.settings.check import prepare

CONFIG = Path(__file__).parents[3] / "config"
VALUES = 50
RNG = np.random.default_rng(1)


def learned(parts=3):
    mean, correction = RNG.normal(size=(2, VALUES))
    return Learned(parts, mean, RNG.uniform(size=4), correction, 0.02, ((0.0, 2.0), (7.0, 9.0)))


MEMORY = Memory(
    "cell", "x", "tuning", 1000.0, 1.5, RNG.normal(size=VALUES), learned(), learned(2), 4, RNG.uniform(size=16),
    ({"file": "run.mcap", "part": "abc", "verdict": "first", "error_um": 0.2},),
)  # fmt: skip


def same(one, other):
    return one.path == other.path and all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for a, b in ((one.now, other.now), (one.before or one.now, other.before or other.now))
        for name in ("parts", "mean_um", "spread_um2", "correction_um", "contraction", "learned_Hz")
    )


@pytest.fixture
def file(tmp_path):
    found = memory_file(tmp_path / "learned", "x")
    write_memory(found, MEMORY)
    return found


def test_what_was_written_is_read(file):
    found = read_memory(file)
    assert same(found, MEMORY)
    assert (found.generation, found.story, found.seconds) == (4, MEMORY.story, 0.05)
    assert np.array_equal(found.blocks_um2, MEMORY.blocks_um2)
    write_memory(file, replace(MEMORY, before=None))
    assert read_memory(file).before is None
    assert read_memory(file.with_name("y.npz")) is None


@pytest.mark.parametrize("interrupted", ["fsync", "rename", "replace", "write"])
def test_who_is_cut_off_while_writing_leaves_the_memory_before(file, monkeypatch, interrupted):
    def cut(*_, **__):
        raise OSError(5, "the power went")

    monkeypatch.setattr(os, interrupted, cut)
    try:
        write_memory(file, replace(MEMORY, generation=5))
    except OSError:
        expected = 4
    else:
        expected = 5  # it has no need of this call
    monkeypatch.undo()
    assert read_memory(file).generation == expected
    assert same(read_memory(file), MEMORY)


def test_a_file_that_is_cut_short_or_altered_is_refused_in_one_sentence(file):
    whole = file.read_bytes()
    for length in range(0, len(whole), 199):
        file.write_bytes(whole[:length])
        with pytest.raises(CheckFailed, match="no memory of `micromanip learn`, or a damaged one"):
            read_memory(file)
    place = whole.index(MEMORY.now.correction_um.tobytes()) + 100
    file.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
    with pytest.raises(CheckFailed, match="CRC"):
        read_memory(file)


@given(st.binary(max_size=400))
def test_nothing_else_passes_for_a_memory(tmp_path_factory, content):
    file = tmp_path_factory.mktemp("garbage") / "x.npz"
    file.write_bytes(content)
    with pytest.raises(CheckFailed):
        read_memory(file)


@pytest.mark.parametrize(
    ("name", "values"),
    [("now.mean_um", np.full(VALUES, np.nan)), ("now.correction_um", np.zeros(3)), ("path_um", np.zeros(VALUES)),
     ("blocks_um2", np.zeros((4, 4))), ("memory.json", np.zeros(3, np.uint8))],
)  # fmt: skip
def test_arrays_that_do_not_belong_together_are_refused(file, name, values):
    with np.load(file) as found:
        arrays = {each: found[each] for each in found.files}
    with file.open("wb") as opened:
        np.savez(opened, **{**arrays, name: values})
    with pytest.raises(CheckFailed, match="or a damaged one"):
        read_memory(file)


def test_a_folder_in_the_place_of_a_file_is_told(tmp_path):
    (tmp_path / "x.npz").mkdir()
    with pytest.raises(Exception, match=r"x\.npz") as told:
        read_memory(tmp_path / "x.npz")
    assert told.value.exit_code


@pytest.mark.parametrize("asked", [("other", "x", "tuning"), ("cell", "y", "tuning"), ("cell", "x", "other")])
def test_the_memory_of_something_else_is_refused_in_one_sentence(asked):
    MEMORY.require("cell", "x", "tuning", "x.npz")
    with pytest.raises(CheckFailed, match=r"x\.npz: this memory is of (cell|axis|tuning) \w+, not of \w+: learn anew"):
        MEMORY.require(*asked, "x.npz")


def test_a_cell_is_known_by_what_it_is_made_of_and_not_by_the_seed_of_its_simulation():
    configuration = prepare(CONFIG / "simulated.yaml").configuration
    cell = configuration.drivers["cell"]
    other = configuration.model_copy(update={"drivers": {"cell": cell.model_copy(update={"seed": 7})}})
    assert cell_name(other) == cell_name(configuration)
    output = configuration.outputs["voltage_x"].model_copy(update={"range_V": (-10.0, 140.0)})
    other = configuration.model_copy(update={"outputs": {**configuration.outputs, "voltage_x": output}})
    assert cell_name(other) != cell_name(configuration)


def test_tool_and_temperature_are_in_it_and_an_older_file_knows_of_none(file):
    write_memory(file, replace(MEMORY, tool=3, temperature_C=21.5))
    found = read_memory(file)
    assert (found.tool, found.temperature_C) == (3, 21.5)
    _rewrite(file, {"format": 1}, without=("tool", "temperature_C"))
    found = read_memory(file)
    assert (found.tool, found.temperature_C) == (0, None)
    assert same(found, MEMORY)


def test_a_file_of_another_version_is_refused_in_one_sentence(file):
    _rewrite(file, {"format": 3})
    with pytest.raises(CheckFailed, match=r"it is of format 3, of another version; this program knows 2.*learn reset"):
        read_memory(file)


def _rewrite(file, changes, without=()):
    with np.load(file) as found:
        arrays = {each: found[each] for each in found.files}
    told = {key: value for key, value in json.loads(bytes(arrays["memory.json"])).items() if key not in without}
    arrays["memory.json"] = np.frombuffer(json.dumps(told | changes).encode(), np.uint8)
    with file.open("wb") as opened:
        np.savez(opened, **arrays)


def _writes_on(file, begun):
    memory = read_memory(file)
    while True:
        memory = replace(memory, generation=memory.generation + 1, begin_s=memory.begin_s + 1.0)
        write_memory(file, memory)
        begun.set()


@pytest.mark.live  # a process that is killed
def test_who_is_killed_in_the_middle_of_writing_leaves_a_whole_memory(file):
    forked = multiprocessing.get_context("fork")
    for after_ms in (0, 1, 2, 3, 5, 8, 13, 21):
        begun = forked.Event()
        writer = forked.Process(target=_writes_on, args=(file, begun), daemon=True)
        writer.start()
        assert begun.wait(60.0)
        writer.join(after_ms * 1e-3)
        writer.kill()
        writer.join()
        found = read_memory(file)
        assert same(found, MEMORY)
        assert found.begin_s - MEMORY.begin_s == found.generation - MEMORY.generation
        assert memory_files(file.parent, "x") == [file], "nothing that was half written is taken for one"
