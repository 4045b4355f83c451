"""A candidate tuning beside the active one: it computes, is promoted without a bump, taken back if it is worse."""

import numpy as np
import pytest

from micromanip.rt import states as rt
from micromanip.rt.faults import EVENTS
from micromanip.rt.records import CELL_STATE
from micromanip.rt.shadow import shadow_cycle, start_shadow, swap_cell, takes_back
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell

from .protected import text


class Shadowed:
    """The cell, tracking, and what the loop does with a candidate around each cycle."""

    def __init__(self, tmp_path):
        file = tmp_path / "cell.yaml"
        file.write_text(text(force="{start_s: 1.6, static_N: 80.0, tooth_N: 40.0, tooth_Hz: 200.0, noise_N: 5.0}"))
        prepared = prepare(file)
        self.active = prepared.parameters
        self.active[0]["figures_step"], self.active[0]["trial_cycles"] = 1.0 / 1000, 1500
        self.active[0]["trial_step"], self.active[0]["trial_factor"] = 1.0 / 300, 2.5  # short: the error comes and goes
        self.cell = VirtualCell(self.active, prepared.wiring)
        self.cell.arm()
        self.cell.run(1.0)
        self.s = self.cell.state[0]
        self.shadow = np.zeros(1, CELL_STATE)[0]
        self.before = self.active.copy()

    def begin(self, change):
        self.candidate = self.active.copy()
        self.candidate[0]["version"] = 2
        for axis in self.candidate[0]["axis"]:
            change(axis)
        start_shadow(self.active[0], self.candidate[0], self.s, self.shadow)
        return self

    def run(self, cycles, command=rt.NO_COMMAND):
        rows = []
        for k in range(cycles):
            given = command if k == 0 else rt.NO_COMMAND
            state = int(self.s["shadow"])
            rows.append(self.cell.run(1e-4, command=given))
            if given == rt.PROMOTE and state == rt.SHADOWING and self.s["shadow"] == rt.ON_TRIAL:
                swap_cell(self.active[0], self.candidate[0], self.s)
                self.before[:] = self.active
                self.active[:] = self.candidate
            elif takes_back(self.active[0], self.s):
                swap_cell(self.active[0], self.before[0], self.s)
                self.active[:] = self.before
            now_ns = int(self.s["cycle"]) * 100_000
            shadow_cycle(self.active[0], self.candidate[0], self.s, self.shadow, self.cell.samples, now_ns)
        return np.concatenate(rows)


@pytest.fixture
def shadowed(tmp_path):
    return Shadowed(tmp_path)


def better_pid(axis):
    axis["pid"]["K_V_per_um"] *= 0.8
    axis["pid"]["integral"] *= 0.8


def too_hot(axis):
    for name in ("K_V_per_um", "integral", "derivative"):
        axis["pid"][name] *= 4.5


def wrong_model(axis):
    axis["outer"]["a_blocks"][0, 0, 0] *= 0.98


def figures(state, name):
    return state["figures"][name]


def test_the_same_tuning_computes_the_same(shadowed):
    shadowed.begin(lambda axis: None).run(300)
    assert figures(shadowed.shadow, "innovation") == pytest.approx(figures(shadowed.s, "innovation"), rel=1e-6)
    assert shadowed.shadow["axis"]["setpoint_um"] == pytest.approx(shadowed.s["axis"]["setpoint_um"], abs=0.5)
    assert shadowed.shadow["axis"]["request_V"] == pytest.approx(shadowed.s["axis"]["request_V"], abs=0.5)


def test_a_candidate_changes_nothing(shadowed, tmp_path):
    alone = Shadowed(tmp_path)
    rows = shadowed.begin(wrong_model).run(200)
    assert rows["axis"].tobytes() == alone.cell.run(0.02)["axis"].tobytes()


def test_promoted_without_a_bump_and_confirmed(shadowed):
    shadowed.begin(better_pid)
    usual = np.abs(np.diff(shadowed.run(500)["axis"]["voltage_V"], axis=0)).max()
    rows = shadowed.run(1600, rt.PROMOTE)
    assert np.abs(np.diff(rows["axis"]["voltage_V"], axis=0)).max() <= 1.3 * usual
    assert shadowed.s["shadow"] == rt.CONFIRMED
    assert shadowed.s["version"] == 2
    assert shadowed.s["state"] == rt.TRACKING


def test_taken_back_by_itself_when_it_is_worse(shadowed):
    shadowed.begin(too_hot).run(300)
    rows = shadowed.run(1500, rt.PROMOTE)
    assert shadowed.s["shadow"] == rt.TAKEN_BACK
    assert shadowed.s["version"] == 1
    assert (shadowed.active[0]["axis"]["pid"]["K_V_per_um"] == shadowed.before[0]["axis"]["pid"]["K_V_per_um"]).all()
    event = shadowed.s["event"][list(shadowed.s["event"]["code"]).index(rt.ROLLED_BACK)]
    assert event["axis"] >= 0
    assert shadowed.s["state"] == rt.TRACKING
    assert np.abs(rows["axis"]["path_error_um"][-300:]).max() < 8.0


def test_withdrawn_before_and_on_trial(shadowed):
    shadowed.begin(better_pid).run(10)
    shadowed.run(1, rt.WITHDRAW)
    assert shadowed.s["shadow"] == rt.NO_SHADOW
    shadowed.begin(better_pid).run(10)
    shadowed.run(50, rt.PROMOTE)
    assert (shadowed.s["shadow"], shadowed.s["version"]) == (rt.ON_TRIAL, 2)
    shadowed.run(2, rt.WITHDRAW)
    assert (shadowed.s["shadow"], shadowed.s["version"]) == (rt.TAKEN_BACK, 1)


def test_a_trial_ends_with_the_tracking(shadowed):
    shadowed.begin(better_pid).run(10)
    shadowed.run(50, rt.PROMOTE)
    shadowed.run(2, rt.DISARM)
    assert (shadowed.s["shadow"], shadowed.s["version"]) == (rt.TAKEN_BACK, 1)
    assert not shadowed.cell.run(1e-4, command=rt.PROMOTE)["fault"].any()
    assert shadowed.s["shadow"] == rt.TAKEN_BACK  # nothing to promote


def test_a_trial_that_cannot_be_judged_is_taken_back(shadowed):
    """Deadlines are missed all the time: nothing is compared, and nothing is taken for proven."""
    shadowed.active[0]["trial_cycles"] = 400
    shadowed.begin(better_pid).run(10)
    shadowed.run(1, rt.PROMOTE)
    for _ in range(1300):
        shadowed.s["overruns"] += 1
        shadowed.run(1)
        if shadowed.s["shadow"] != rt.ON_TRIAL:
            break
    assert (shadowed.s["shadow"], shadowed.s["version"]) == (rt.TAKEN_BACK, 1)
    assert shadowed.s["trial_cycles"] == pytest.approx(1200, abs=2)
    event = shadowed.s["event"][(int(shadowed.s["events"]) - 1) % EVENTS]
    assert (event["code"], event["axis"]) == (rt.ROLLED_BACK, -1)  # no axis is to blame
    assert 0.0 < event["value"] <= event["limit"]


def test_a_single_stall_only_makes_the_trial_rest(shadowed):
    shadowed.begin(too_hot).run(10)
    shadowed.run(1, rt.PROMOTE)
    shadowed.s["overruns"] += 1
    before = shadowed.s["trial_now"].copy()
    shadowed.run(100)
    assert (shadowed.s["trial_now"] == before).all()
    shadowed.run(1500)
    assert shadowed.s["shadow"] == rt.TAKEN_BACK
