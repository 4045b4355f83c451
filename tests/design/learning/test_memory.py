"""The file of a memory: what was written is read, whole or not at all, and nothing else passes for one."""

import json
import multiprocessing
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.design.learning.memory import Memory, memory_files, put_aside, read_memory, remove_memory, write_memory
from micromanip.errors import CheckFailed, MicromanipError

VALUES = 50
RNG = np.random.default_rng(1)
MEMORY = Memory(
    "cell", "x", "tuning", 1000.0, *RNG.normal(size=(3, VALUES)), RNG.uniform(size=4), RNG.uniform(size=16), 3, 0.02,
    ((0.0, 2.0), (7.0, 9.0)), 4, 3, 21.5,
)  # fmt: skip


def same(one, other, but=()):
    return all(
        np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in fields(Memory) if f.name not in but
    )


@pytest.fixture
def file(tmp_path):
    write_memory(tmp_path / "x.npz", MEMORY)
    return tmp_path / "x.npz"


def test_what_was_written_is_read(file):
    assert same(read_memory(file), MEMORY)
    write_memory(file, replace(MEMORY.forgotten(), temperature_C=None))
    found = read_memory(file)
    assert (found.parts, found.temperature_C, found.tool, found.seconds) == (0, None, 3, 0.05)


def test_a_file_that_is_cut_short_or_altered_is_refused_in_one_sentence(file):
    whole = file.read_bytes()
    for length in range(0, len(whole), 199):
        file.write_bytes(whole[:length])
        with pytest.raises(CheckFailed, match="no memory of learning, or a damaged one"):
            read_memory(file)
    place = whole.index(MEMORY.correction_um.tobytes()) + 100
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
    [("mean_um", np.full(VALUES, np.nan)), ("correction_um", np.zeros(3)), ("path_um", np.zeros(VALUES)),
     ("blocks_um2", np.zeros((4, 4))), ("memory.json", np.zeros(3, np.uint8)), ("memory.json", {"format": 2})],
)  # fmt: skip
def test_what_does_not_belong_together_or_is_of_another_version_is_refused(file, name, values):
    with np.load(file) as found:
        arrays = {each: found[each] for each in found.files}
    if isinstance(values, dict):
        told = json.loads(bytes(arrays["memory.json"])) | values
        values = np.frombuffer(json.dumps(told).encode(), np.uint8)
    with file.open("wb") as opened:
        np.savez(opened, **{**arrays, name: values})
    with pytest.raises(CheckFailed, match="or a damaged one"):
        read_memory(file)


def test_what_is_no_memory_is_not_removed_and_what_cannot_be_put_aside_stays(file, tmp_path):
    np.savez(tmp_path / "y.npz", a=np.zeros(3))
    with pytest.raises(CheckFailed, match="it stays"):
        remove_memory(tmp_path / "y.npz")
    (tmp_path / "x.npz.before_fault").mkdir()
    with pytest.raises(MicromanipError, match=r"x\.npz"):
        put_aside(file)
    assert same(read_memory(file), MEMORY)
    remove_memory(file)
    assert not file.exists()


def _writes_on(file, begun):
    memory = read_memory(file)
    while True:
        memory = replace(memory, generation=memory.generation + 1, contraction=memory.contraction + 1.0)
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
        assert same(found, MEMORY, ("generation", "contraction"))
        assert round(found.contraction - MEMORY.contraction) == found.generation - MEMORY.generation
        assert memory_files(file.parent, "x") == [file], "nothing that was half written is taken for one"
