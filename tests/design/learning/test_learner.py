"""From recordings to memories: what is learned from, and what is refused with one sentence and without a trace."""

from functools import partial

import numpy as np
import pytest

from micromanip.design.learning.learner import Learner
from micromanip.design.learning.memory import memory_file, read_memory
from micromanip.errors import CheckFailed
from micromanip.rt.states import READY, TRACKING

from .played import SECONDS, recording

pytestmark = pytest.mark.long

SHIFT = 437
"""Cycles."""


def silent(_):
    pass


@pytest.fixture(scope="module")
def learner(tmp_path_factory):
    return Learner(tmp_path_factory.mktemp("memory"), 5.0, 0.2, None)


@pytest.fixture(scope="module")
def learn(learner):
    return partial(learner.update, axes=["y"], begin_s=None, seconds=None, say=silent)


@pytest.fixture(scope="module")
def first(prepared, learner, learn, noisy):
    rows, begin_s = noisy
    with pytest.raises(CheckFailed, match=r"no memory of axis y yet: say when .* \(--begin, --seconds\)"):
        learn(recording(prepared, rows))
    found = learn(recording(prepared, rows), begin_s=begin_s, seconds=SECONDS)["y"]
    learner.write({"y": found})
    return found


@pytest.fixture(scope="module")
def other(cell):
    return cell.make(2, {})


def test_a_recording_teaches_what_its_rows_do(cell, noisy, first, learner):
    memory = cell.learn(*noisy, "rows")["y"].memory if not cell.memories else cell.memories["y"]
    kept = read_memory(memory_file(learner.folder, "y"))
    assert kept.path == first.memory.path == memory.path
    assert (kept.axis, kept.now.parts, kept.seconds) == ("y", 1, SECONDS)
    assert 0.0 <= kept.now.contraction < 1.0
    assert first.error_um == pytest.approx(first.memory.story[-1]["error_um"])
    assert first.interval_um[0] < first.error_um < first.interval_um[1]


def test_the_path_is_found_wherever_it_begins(prepared, first, learn, other):
    """The same noise, recorded from another cycle on: the same part, to a fiftieth of a millisecond."""
    rows, begin_s = other
    at_once = learn(recording(prepared, rows), begin_s=begin_s)["y"].memory
    tracking = rows[rows["state"] == TRACKING]
    later = learn(recording(prepared, tracking[SHIFT:]), begin_s=begin_s)["y"].memory
    for name in ("mean_um", "correction_um"):
        one, two = getattr(at_once.now, name), getattr(later.now, name)
        assert np.std(one - two) < 0.02 * np.std(one) + 1e-4
    assert at_once.now.parts == 2


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"deviation_um": lambda x: 1.03 * x}, r"run\.mcap: axis y follows another path than its memory's"),
        ({"deviation_um": lambda x: x[::-1]}, "follows another path than its memory's .* um rms, at most"),
        ({"voltage_V": lambda x: np.where(np.arange(len(x))[:, None] % 20, x, 150.0)}, "an end of its range for 5 %"),
        ({"state": lambda x: np.where(np.arange(len(x)) < len(x) // 2, x, READY)}, "was not finished, nothing is"),
        ({"state": lambda x: np.full_like(x, READY)}, "the cell does not track in it"),
        ({"fresh": lambda x: x & ~4}, "no samples of the tracker came"),
        ({"version": lambda x: np.arange(len(x)) // 9000}, "under one tuning, the part of 2.5 s begins at"),
        ({"learned_um": lambda x: x + 1.0}, "a correction of 1 um rms was played to axis y"),
    ],
)  # fmt: skip
def test_what_does_not_belong_to_the_memory_is_refused(prepared, first, learn, other, changed, message):
    rows, begin_s = other
    ((column, change),) = changed.items()
    values = (rows if column in rows.dtype.names else rows["axis"])[column]
    with pytest.raises(CheckFailed, match=message):
        learn(recording(prepared, rows, **{column: change(values)}), begin_s=begin_s)


def test_few_missed_cycles_are_borne_and_many_refused(prepared, first, learn, other):
    rows, begin_s = other
    kept = np.ones(len(rows), bool)
    kept[np.arange(0, len(rows), 50)] = False
    borne = learn(recording(prepared, rows[kept]), begin_s=begin_s)["y"].memory
    assert borne.story[-1]["missed_percent"] == pytest.approx(2.0, abs=0.01)
    few = borne.now
    whole = learn(recording(prepared, rows), begin_s=begin_s)["y"].memory.now
    assert np.std(few.mean_um - whole.mean_um) < 0.5 * np.std(whole.mean_um)
    kept[np.arange(0, len(rows), 15)] = False
    with pytest.raises(CheckFailed, match=r"8\.\d % of the part's cycles were missed, at most 5 % may be"):
        learn(recording(prepared, rows[kept]), begin_s=begin_s)


def test_another_tuning_and_another_cell_are_refused(prepared, first, learn, other):
    rows, begin_s = other
    text = prepared.source.text
    gain = f"K_V_per_um: {prepared.configuration.axes['y'].inner.K_V_per_um:g}"
    assert text.count(gain) == 1
    for old, new, what in (
        (gain, "K_V_per_um: 0.2", "tuning"),
        ("tooth_N: 40.0", "tooth_N: 50.0", "cell"),
    ):
        with pytest.raises(CheckFailed, match=rf"y\.npz: this memory is of {what} \w+, not of \w+: learn anew"):
            learn(recording(prepared, rows, text=text.replace(old, new)), begin_s=begin_s)


def test_what_can_not_learn_says_why(prepared, learn, other):
    rows, begin_s = other
    text = prepared.source.text.replace("centre_um: 66 ", "authority_percent: 50\n    centre_um: 66 ")
    with pytest.raises(CheckFailed, match="authority_percent is 50: it learns with 100 only"):
        learn(recording(prepared, rows, text=text), begin_s=begin_s)
    for begin, seconds, message in ((0.1, 2.5, "needs 0.5 s to have settled"), (1.0, 1.0, "too short to learn from")):
        with pytest.raises(CheckFailed, match=message):
            learn(recording(prepared, rows), axes=["x"], begin_s=begin, seconds=seconds)
