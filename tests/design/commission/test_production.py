"""Which cell tracks, following what; and how its trial is judged."""

from dataclasses import replace

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.design.commission.production import in_production, tried
from micromanip.design.commission.quiescent_spectrum import AtRest
from micromanip.design.experiment import with_axes, with_axis
from micromanip.errors import CheckFailed
from micromanip.settings.load import load
from micromanip.settings.schema.reference import Hold, Tracker
from micromanip.settings.write import with_production

TUNED, FACTORY = load(CONFIG / "simulated.yaml"), load(CONFIG / "factory.yaml")
UNFOLLOWED = with_axes(TUNED, mode="strain").model_copy(update={"reference": Hold(source="hold", offset_um=66.0)})
REST = AtRest(500.0, 0.3, 6.5, 200.0, 2.0)
NAMES = tuple("xyz")


def test_a_tuned_cell_follows_its_tracker_with_every_stage():
    production = in_production(UNFOLLOWED, REST)
    assert production.tracks
    assert {axis.mode for axis in production.configuration.axes.values()} == {"stage"}
    reference = production.configuration.reference
    assert (reference.source, reference.sample_rate_Hz, reference.noise_um) == ("signal", 500.0, 0.3)
    assert any("200 Hz" in sentence for sentence in production.decided)


def test_a_tracker_that_the_user_described_stays():
    described = Tracker(source="signal", predict=False, noise_um=2.0)
    production = in_production(UNFOLLOWED.model_copy(update={"reference": described}), REST)
    assert production.configuration.reference == described


def test_what_cannot_track_stays_as_it_is_and_says_why():
    half = in_production(FACTORY, REST)
    assert half.configuration == FACTORY
    assert "axis x, y, z has no outer loop" in half.obstacle
    blind = UNFOLLOWED.model_copy(
        update={"signals": {k: v for k, v in UNFOLLOWED.signals.items() if k != "deviation_y"}}
    )
    assert "no signal deviation_y" in in_production(blind, REST).obstacle


def test_a_tuning_that_misses_a_criterion_does_not_follow_a_robot():
    missed = in_production(UNFOLLOWED, REST, missed=2)
    assert missed.obstacle == "2 criteria are not met"
    assert missed.configuration == UNFOLLOWED


def test_the_file_says_how_it_runs_and_one_that_says_so_is_not_touched(tmp_path):
    text = (CONFIG / "simulated.yaml").read_text(encoding="utf-8")
    assert load_text(tmp_path, with_production(text, TUNED)) == TUNED
    changed = in_production(UNFOLLOWED, REST).configuration
    written = load_text(
        tmp_path,
        with_production(
            (
                text.replace("source: signal", "source: hold\n  offset_um: 66").split("  predict:")[0]
                + "\naxes:"
                + text.split("\naxes:")[1]
            ).replace("mode: stage", "mode: strain"),
            changed,
        ),
    )
    assert written.reference == changed.reference
    assert [axis.mode for axis in written.axes.values()] == ["stage"] * 3


def load_text(tmp_path, text):
    file = tmp_path / "cell.yaml"
    file.write_text(text, encoding="utf-8")
    return load(file)


def rows(left, moved):
    columns = (*(f"{each}_um" for each in ("path_error", "uncompensated", "stage", "setpoint")), "voltage_V")
    made = np.zeros(20_000, [("axis", [(each, "f8") for each in columns], (3,))])
    made["axis"]["setpoint_um"] = 66.0
    made["axis"]["path_error_um"], made["axis"]["uncompensated_um"] = left, moved
    made["axis"]["path_error_um"][:10_000] = 50.0  # the correction is faded in
    return made


def test_the_trial_is_judged_by_what_is_left_of_the_path_error():
    production = in_production(UNFOLLOWED, REST)
    seen = tried(production, lambda each: each, lambda *_: rows(0.6, 100.0))
    assert seen.seen["y"].rms == pytest.approx(0.6)
    good = seen.criterion("y", 0.5)
    assert good.passed
    assert "<= 5.1 um rms" in good.limit, "5 % of 100 um, and twice the tracker's noise"
    assert not tried(production, lambda each: each, lambda *_: rows(5.2, 100.0)).criterion("y", 0.5).passed
    accept = TUNED.axes["y"].accept.model_copy(update={"tracking_error_um": 0.5})
    strict = replace(seen, configuration=with_axis(seen.configuration, "y", accept=accept))
    assert not strict.criterion("y", 0.5).passed
    assert strict.criterion("x", 0.5).passed


def test_a_trial_that_ends_early_is_no_pass():
    def ended(*_):
        raise CheckFailed("ended by fault X-202")

    production = tried(in_production(UNFOLLOWED, REST), lambda each: each, ended)
    assert not production.criterion("x", 0.5).passed
    assert "X-202" in production.criterion("x", 0.5).value
    gap = tried(production, lambda each: each, lambda *_: rows(np.nan, 100.0))
    assert not gap.criterion("x", 0.5).passed
