"""Who follows the tooth's frequency: those axes whose own trials are better for it."""

from dataclasses import replace

import numpy as np

from campaigns.report import CONFIG
from micromanip.design.commission.cell import RANGE_PERCENT, with_followed_tooth
from micromanip.design.commission.production import PathErrorSeen, Production
from micromanip.design.experiment import with_axis
from micromanip.settings.load import load

NAMES = tuple("xyz")
TUNED = load(CONFIG / "simulated.yaml")
for name in NAMES:
    fixed = TUNED.axes[name].outer.model_copy(update={"oscillation_range_percent": 0.0})
    TUNED = with_axis(TUNED, name, outer=fixed)
NONE = np.zeros(0)


def seen(**rms):
    return {name: PathErrorSeen(100.0, rms[name], 5.0 * rms[name], NONE, NONE) for name in rms}


class Trials:
    """What a cell would show: by whether its frequency is right, and whether it follows, um by axis."""

    def __init__(self, **left):
        self.left, self.played = left, []

    def __call__(self, production):
        outers = {name: axis.outer for name, axis in production.configuration.axes.items()}
        self.played.append(outers)
        left = {}
        for name, outer in outers.items():
            speed = "right" if outer.oscillation_Hz == 200.0 else "wrong"
            kind = f"followed_{speed}" if outer.oscillation_range_percent > 0.0 else speed
            left[name] = self.left[kind][name]
        return replace(production, seen=seen(**left))


def decided(trials):
    begun = Production(TUNED, decided=("A tooth.",), seen=seen(**trials.left["right"]))
    ended = with_followed_tooth(begun, trials)
    ranges = {name: axis.outer.oscillation_range_percent for name, axis in ended.configuration.axes.items()}
    assert {axis.outer.oscillation_Hz for axis in ended.configuration.axes.values()} == {200.0}
    assert ended.decided[0] == "A tooth."
    return ranges, ended


SAME = dict.fromkeys(NAMES, 0.5)


def test_it_is_followed_where_a_wrong_speed_costs_less_then():
    trials = Trials(right=SAME, wrong=dict.fromkeys(NAMES, 1.0), followed_right=SAME, followed_wrong=SAME)
    ranges, ended = decided(trials)
    assert ranges == dict.fromkeys(NAMES, RANGE_PERCENT)
    assert "axis x, y, z" in ended.decided[-1]
    assert len(trials.played) == 3, "right and followed, wrong and fixed, wrong and followed"


def test_an_axis_that_pays_at_the_right_speed_stays_as_it_is():
    dearer = SAME | {"y": 0.52}
    ranges, ended = decided(
        Trials(right=SAME, wrong=dict.fromkeys(NAMES, 1.0), followed_right=dearer, followed_wrong=SAME)
    )
    assert ranges == {"x": RANGE_PERCENT, "y": 0.0, "z": RANGE_PERCENT}
    assert ended.seen["y"].rms == 0.5, "what is told is of the cell as it is left"


def test_a_trial_that_ends_in_a_fault_leaves_it_out():
    ended = with_followed_tooth(
        Production(TUNED, seen=seen(**SAME)), lambda each: replace(each, problem="X-216 axis x: it swings")
    )
    assert ended.configuration == TUNED
    assert "left out: X-216 axis x" in ended.decided[-1]
