"""What is drawn can be drawn again, and every kind of step comes and can be done."""

import yaml

from campaigns import plan as plans
from campaigns.acts import ACTS
from campaigns.cells import CELLS
from campaigns.plan import plan
from campaigns.played.amplifier import READS
from campaigns.played.port import CUTS
from campaigns.spoilt_files import SPOILT, spoil


def test_same_seed_same_steps():
    assert plan(1, 17) == plan(1, 17)
    assert plan(1, 17) != plan(2, 17)
    assert plan(1, 17) != plan(1, 18)


def test_a_thousand_have_everything():
    steps = [step for number in range(1000) for step in plan(1, number)]
    assert {step.kind for step in steps} == set(ACTS)
    seen = {kind: {step.more.get(key) for step in steps if step.kind == kind} for kind, key in _ONE_OF}
    assert seen["cut"] == set(CUTS)
    assert seen["reads fail"] == set(READS)
    assert seen["spoil"] == set(SPOILT)
    assert seen["freeze"] == {"loop", "worker", "host", "device"}
    assert seen["kill"] == {"loop", "worker", "host", "recorder", "black box", "host and loop", "all"}
    lasts_ms = [step.more["ms"] for step in steps if step.kind == "cut"]
    assert min(lasts_ms) < plans.RAMP_MS / 2 < 2 * plans.RAMP_MS < max(lasts_ms)


_ONE_OF = (("cut", "how"), ("reads fail", "how"), ("spoil", "how"), ("freeze", "who"), ("kill", "who"))


def test_each_cell_s_file_can_be_spoilt_in_each_way():
    for cell in CELLS.values():
        text = cell.text(4711)
        assert yaml.safe_load(text)["start"]["ramp_s"] * 1e3 == plans.RAMP_MS
        bounds = cell.bounds(text)
        assert set(bounds) == {"voltage_x", "voltage_y"}
        assert all(cell.bounds_after(bounds, changes) for changes in plans.GOOD_SETS)
        assert len({spoil(text, how) for how in SPOILT}) == len(SPOILT)
        assert text.encode() not in {spoil(text, how) for how in SPOILT}
