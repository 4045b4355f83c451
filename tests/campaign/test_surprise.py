"""A few of what the campaign `surprise` does a thousand times, each kind of break once."""

import pytest

from campaigns.cells import CELLS
from campaigns.interleaving import interleave
from campaigns.plan import Step
from campaigns.watched_bench import WatchedBench

LONG_MS, SHORT_MS = 900, 100
"""Longer and shorter than start.ramp_s."""
INTERLEAVINGS = (
    [Step("arm", 500), Step("cut", LONG_MS, {"how": "refused", "ms": LONG_MS})],
    [Step("arm", 500), Step("cut", 50, {"how": "deaf", "ms": SHORT_MS}), Step("arm", 0), Step("disarm", 0)],
    [Step("arm", 500), Step("freeze", 100, {"who": "device", "ms": 400}), Step("jog", 0, {"axis": "x", "by_um": 40.0})],
    [Step("arm", 400), Step("hold", 50), Step("freeze", 0, {"who": "loop", "ms": 300}), Step("reset", 300)],
    [Step("arm", 500), Step("kill", 0, {"who": "worker"}), Step("garbage", 0, {"seed": 7}), Step("arm", 100)],
    [
        Step("arm", 500),
        Step("kill", 0, {"who": "all"}),
        Step("spoil", 0, {"how": "park out of range"}),
        Step("park", 0, {"wait_s": 5}),
    ],
)


@pytest.mark.live
@pytest.mark.thorough  # cuts, kills and stops on this device: tests/hil/test_steps.py; a bad file: test_safe_outputs.py
@pytest.mark.xdist_group("loop")
def test_no_rule_is_broken(tmp_path):
    bench = WatchedBench(tmp_path, CELLS["gcs"])
    try:
        bench.start()
        assert bench.alive, bench.notes
        done = [interleave(bench, number, steps) for number, steps in enumerate(INTERLEAVINGS)]
    finally:
        left = bench.end()
    assert left == []
    assert [(each.number, each.violations, each.course) for each in done if each.broken] == []
    assert all(each.arrivals > 0 and each.largest_step_V > 1.0 for each in done), "the device was given nothing"
