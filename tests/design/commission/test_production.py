"""Which cell tracks, following what; and how its trial is judged."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from micromanip.design.budget.budget import AxisBudget, Bound, Cause, Variant
from micromanip.design.commission.at_rest import AtRest
from micromanip.design.commission.production import PathErrorSeen, Production, in_production, tried
from micromanip.design.experiment import with_axes, with_axis
from micromanip.errors import CheckFailed
from micromanip.settings.load import load
from micromanip.settings.schema.reference import Hold, Tracker
from micromanip.settings.write import with_production

FOLDER = Path(__file__).parents[3] / "config"
TUNED, FACTORY = load(FOLDER / "simulated.yaml"), load(FOLDER / "factory.yaml")
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


def test_what_an_axis_does_not_reach_is_believed_all_the_same_and_said():
    setpoint = UNFOLLOWED.axes["y"].setpoint.model_copy(update={"range_um": (46.0, 76.0)})
    production = in_production(with_axis(UNFOLLOWED, "y", setpoint=setpoint), REST)
    assert production.configuration.reference.range_um == (-300.0, 300.0)
    (said,) = (sentence for sentence in production.decided if "reaches" in sentence)
    assert said.startswith("Axis y reaches -100 to 50 um"), "20 um of the actuator are 100 of the stage"
    assert said.endswith("with centre_um at the middle of its set-points, 61 um, it would reach -75 to 75 um.")


def test_a_tracker_that_the_user_described_stays():
    described = Tracker(source="signal", predict=False, noise_um=2.0)
    production = in_production(UNFOLLOWED.model_copy(update={"reference": described}), REST)
    assert production.configuration.reference == described


def test_what_cannot_track_stays_as_it_is_and_says_why():
    half = in_production(FACTORY, REST)
    assert half.configuration == FACTORY
    assert "axis x, y, z has no outer loop yet" in half.obstacle
    blind = UNFOLLOWED.model_copy(
        update={"signals": {k: v for k, v in UNFOLLOWED.signals.items() if k != "deviation_y"}}
    )
    assert "no signal deviation_y" in in_production(blind, REST).obstacle


def test_a_tuning_that_misses_a_criterion_does_not_follow_a_robot():
    missed = in_production(UNFOLLOWED, REST, missed=2)
    assert missed.obstacle == "2 criteria are not met"
    assert missed.configuration == UNFOLLOWED


def test_no_tooth_is_said():
    axes = {name: axis.outer.model_copy(update={"oscillation_Hz": None}) for name, axis in UNFOLLOWED.axes.items()}
    without = UNFOLLOWED
    for name, outer in axes.items():
        without = with_axis(without, name, outer=outer)
    (said, _) = in_production(without, AtRest(1000.0, 0.5, None, None)).decided
    assert said.startswith("No tooth frequency is cancelled: none was given")


def test_the_file_says_how_it_runs_and_one_that_says_so_is_not_touched(tmp_path):
    text = (FOLDER / "simulated.yaml").read_text(encoding="utf-8")
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


def test_time_at_an_end_of_the_range_is_told_beside_the_figures():
    made = rows(0.6, 100.0)
    made["axis"]["setpoint_um"][12_000:13_000, 1] = 128.0
    made["axis"]["voltage_V"][12_500:13_500, 1] = 150.0
    seen = tried(in_production(UNFOLLOWED, REST), lambda each: each, lambda *_: made)
    assert seen.criterion("y", 0.5).value.endswith("0.6 um at most, at an end of its range 15 % of the time")
    assert seen.criterion("x", 0.5).value.endswith("0.6 um at most")


def test_a_trial_that_ends_early_is_no_pass():
    def ended(*_):
        raise CheckFailed("ended by fault X-202")

    production = tried(in_production(UNFOLLOWED, REST), lambda each: each, ended)
    assert not production.criterion("x", 0.5).passed
    assert "X-202" in production.criterion("x", 0.5).value
    gap = tried(production, lambda each: each, lambda *_: rows(np.nan, 100.0))
    assert not gap.criterion("x", 0.5).passed


def test_the_report_has_it(tmp_path):
    seen = PathErrorSeen(100.0, 0.6, 2.0, np.zeros(2), np.zeros(2))
    section = Production(TUNED, decided=("So it is.",), seen=dict.fromkeys(NAMES, seen)).sections("x")[0]
    assert "0.600 um rms, 2.00 um at most" in section.figures["path error"]
    assert section.text.endswith("So it is.")


def budget_of(axis):
    hertz = np.array([0.5, 50.0, 500.0])
    causes = (Cause("force", np.array([0.0, 0.16, 0.0])), Cause("noise", np.array([0.08, 0.0, 0.01])))
    tiny = Cause("creep", np.array([1e-6, 0.0, 0.0]))
    return AxisBudget(axis, hertz, (*causes, tiny), Bound(0.03, 0.0325, 1.0), (Variant("no force", 0.3),))


def test_the_report_tells_what_the_error_of_the_trial_is_made_of():
    production = in_production(UNFOLLOWED, REST)
    given = []

    def budgeted(configuration, played):
        given.append((configuration, played))
        return [budget_of(name) for name in NAMES]

    made = rows(0.5, 100.0)
    found = tried(production, lambda each: each, lambda *_: made, budgeted)
    assert given[0][0] == production.configuration
    assert given[0][1] is made
    _, section = found.sections("y")
    causes, others = section.tables
    assert [row[:3] for row in causes.rows] == [
        ("force", "0.400 um", "64.0 %"), ("noise", "0.300 um", "36.0 %"), ("creep", "0.001 um", "0.0 %"),
        ("whole", "0.500 um", "100.0 %"),
    ]  # fmt: skip
    assert others.rows == (("no force", "0.300 um"),)
    assert section.figures["this one leaves"] == "2.0 times that"
    whole, force, noise, rest, bound = section.plots[0].curves
    assert whole.y == pytest.approx([0.08, 0.24, 0.25], abs=1e-5), "below 0.5, 50 and 500 Hz"
    assert [force.label, noise.label, rest.label] == ["force", "noise", "everything else"]
    assert force.y + noise.y + rest.y == pytest.approx(whole.y)
    assert bound.y == pytest.approx([0.0625, 0.0625])


def test_where_no_budget_can_be_made_it_says_why_and_tracks_all_the_same():
    def refused(*_):
        raise CheckFailed("axis x is behind a bus")

    found = tried(in_production(UNFOLLOWED, REST), lambda each: each, lambda *_: rows(0.6, 100.0), refused)
    assert found.criterion("x", 0.5).passed
    trial, section = found.sections("x")
    assert trial.title == "In production"
    assert section.text == "That is not told: axis x is behind a bus."
