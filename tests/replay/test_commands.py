"""Which commands a recording tells of, by what it holds: here those of parts."""

import numpy as np
import pytest

from micromanip.replay.self_replay import infer_commands
from micromanip.rt.records import CELL_STATE
from micromanip.rt.states import BEGIN_PART, END_PART, NO_COMMAND, TRACKING
from micromanip.rt.telemetry import PART_RUNS, PART_TURN, ROW


@pytest.mark.parametrize("wired", [False, True])
def test_parts_that_begin_end_and_follow_one_another(wired):
    """One runs, ends, the next begins, and another at once; what a signal has said was no command."""
    lines = [PART_RUNS, PART_RUNS, 0, 0, PART_RUNS | PART_TURN, PART_RUNS, 0]
    rows, before = np.zeros(len(lines), ROW), np.zeros(1, CELL_STATE)[0]
    rows["lines"], rows["state"], before["state"] = lines, TRACKING, TRACKING
    before["part"], before["parts"] = 2, 2
    expected = [NO_COMMAND, NO_COMMAND, END_PART, NO_COMMAND, BEGIN_PART, BEGIN_PART, END_PART]
    assert infer_commands(rows, before, wired).tolist() == ([NO_COMMAND] * len(lines) if wired else expected)
