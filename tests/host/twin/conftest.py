"""Recordings of the simulated cell, and the two that replay them: our cycle and its C twin."""

import pytest

from micromanip.cli.system_bench import source_tree
from micromanip.settings.check import prepare

from .scene import TRACKING_CYCLES, Scene


@pytest.fixture(scope="package", autouse=True)
def _no_loop_around_our_cycle():
    """It is the very cycle that is compared; with the benchmark's loop around it, it would be compiled once more."""
    from benchmarks import recording

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording, "replay", recording.replay.py_func)
        yield


@pytest.fixture(scope="package")
def prepared():
    return prepare(source_tree() / "config" / "paper.yaml")


@pytest.fixture(scope="package")
def tracking(prepared):
    from benchmarks.recording import record_tracking

    return record_tracking(prepared, 0.1, TRACKING_CYCLES)


@pytest.fixture
def scene(tracking):
    return Scene(tracking)


@pytest.fixture(scope="package")
def twin(tmp_path_factory):
    from benchmarks.recording import twin_player
    from benchmarks.runner import Skipped

    try:
        return twin_player(tmp_path_factory.mktemp("twin"))
    except Skipped as reason:
        pytest.skip(str(reason))


@pytest.fixture
def agreed(twin):
    """Replays a recording both ways, demands agreement, returns our outcome."""
    from benchmarks.agreement import require_agreement
    from benchmarks.recording import Outcome, ours

    def replay(recording):
        left, right = (Outcome.room(len(recording.signals)) for _ in range(2))
        ours(recording, left, 1)
        twin(recording, right, 1)
        require_agreement(left, right)
        return left

    return replay
