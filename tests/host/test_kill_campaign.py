"""A short run of what `make soak-kill` does a hundred times, and proof that its watch sees what it is there for."""

from types import SimpleNamespace

import numpy as np
import pytest

from micromanip.host.shared_memory import RING, RING_ROWS
from micromanip.rt.mailbox import RING_HEAD
from micromanip.rt.records import CELL_PARAMETERS
from micromanip.rt.states import READY, TRACKING
from tools.kills.campaign import VICTIMS, campaign
from tools.kills.envelope import Envelope

pytestmark = pytest.mark.realtime  # a stall must not outlast the watches


@pytest.mark.thorough  # test_death.py, test_recording_fails.py and test_trips.py kill each process, too
def test_each_process_once(tmp_path):
    kills = list(campaign(len(VICTIMS), 7, tmp_path))
    assert [kill.victim for kill in kills] == list(VICTIMS)
    for kill in kills:
        assert kill.violations == [], f"{kill.victim}, {kill.moment}: {kill.violations}"
        assert kill.left == []
    assert {kill.outcome for kill in kills} == {
        "the loop went on",
        "parked by the loop",
        "the loop went on; started again",
        "safe by the host, X-104",
    }
    assert [entry.name for entry in tmp_path.iterdir()] == ["locks"]


def watched(voltage_V, head=None):
    """What the watch says of one axis that READY leaves for these voltages; range -20 to 150 V, 4 V a cycle."""
    parameters, ring = np.zeros(1, CELL_PARAMETERS), np.zeros(1, RING)[0]
    parameters["axes"], parameters["period_ns"] = 1, 100_000
    limiter = parameters[0]["axis"]["limiter"]
    limiter["low_V"], limiter["high_V"], limiter["slew_V"] = -20.0, 150.0, 4.0
    count = len(voltage_V)
    rows = ring["rows"]
    rows["axis"]["voltage_V"][:count, 0] = voltage_V
    rows["cycle"][:count], rows["time_ns"][:count] = np.arange(count), 100_000 * np.arange(count)
    rows["state"][:count] = np.where(np.arange(count) < 2, READY, TRACKING)
    ring["words"][RING_HEAD] = count if head is None else head
    envelope = Envelope(SimpleNamespace(control={"parameters": parameters}, ring=ring))
    envelope.end()
    return envelope


def test_the_watch_sees_each_violation():
    good = watched([0.0, 4.0, 8.0, 4.0])
    assert good.fresh_violations() == []
    assert (good.cycles, good.fresh_step()) == (4, 4.0)
    assert good.names_since(0) == ["READY", "TRACKING"]
    assert good.names_since(200_000) == ["TRACKING"]
    (step,) = watched([0.0, 4.0, 8.1]).fresh_violations()
    assert step.startswith("cycle 2: [4.] V to [8.1] V, faster than the slew limit")
    assert "outside the range" in watched([*np.arange(0.0, -24.1, -4.0)]).fresh_violations()[0]
    assert "not finite" in watched([0.0, np.nan]).fresh_violations()[0]
    assert watched([0.0], head=RING_ROWS + 5).fresh_violations() == ["6 cycles passed unseen"]
