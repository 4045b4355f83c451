"""History and verdict: what stands in the file, what another program makes of it, and what is said of drawn series."""

import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.signal import cont2discrete

from micromanip.control.injection import injection
from micromanip.control.system import System
from micromanip.design.analyse.health.history import (
    COLUMNS,
    HEADER,
    Check,
    PlantFigures,
    append,
    commissioned,
    plant_figures,
    read_history,
)
from micromanip.design.analyse.health.trend import Cusum, average_run_length, change_point, judge, limit_for
from micromanip.design.identify.response import Measured
from micromanip.errors import CheckFailed
from micromanip.settings.schema.accept import Accept

HERTZ = injection(0.3, 3000.0, 10_000.0, seed=1).frequency_Hz
NEAR = PlantFigures(5.0, 67.0, 0.02)


def measured(response, noise=0.0, seed=1):
    rng = np.random.default_rng(seed)
    seen = response * (1.0 + noise * (rng.normal(size=len(HERTZ)) + 1j * rng.normal(size=len(HERTZ))))
    deviation = np.full(len(HERTZ), noise) * np.abs(response)
    return Measured(HERTZ, seen, seen[None], deviation, deviation)


def flexure(gain, mode_Hz, damping, delay_s=2e-4):
    s, w = 2j * np.pi * HERTZ, 2 * np.pi * mode_Hz
    return gain * np.exp(-s * delay_s) * w**2 / (s**2 + 2 * damping * w * s + w**2)


@pytest.mark.parametrize(("gain", "mode_Hz", "damping"), [(5.0, 67.0, 0.02), (4.2, 52.0, 0.005), (6.0, 81.0, 0.1)])
def test_a_flexure_is_what_it_is(gain, mode_Hz, damping):
    found = plant_figures(measured(flexure(gain, mode_Hz, damping)), measured(np.full(len(HERTZ), 0.61)), NEAR)
    expected = (gain, mode_Hz, damping, 0.61)
    assert (found.stage_gain, found.mode_Hz, found.mode_damping, found.actuator_um_per_V) == pytest.approx(
        expected, rel=1e-4
    )


def test_noise_and_a_mode_above_move_it_little():
    """A mode three times as high with a tenth of the gain is not in the model."""
    response = flexure(5.0, 67.0, 0.02) + flexure(0.5, 201.0, 0.02)
    found = [plant_figures(measured(response, 0.05, seed), None, NEAR) for seed in range(10)]
    assert np.mean([each.mode_Hz for each in found]) == pytest.approx(67.0, rel=0.005)
    assert np.std([each.mode_Hz for each in found]) < 0.3
    assert np.mean([each.mode_damping for each in found]) == pytest.approx(0.02, rel=0.25)


def test_the_models_figures_are_what_would_be_measured_of_it():
    """A second mode bends the response about the first: its gain there is 11 % less than at rest."""
    period_s, parts = 1e-4, []
    for gain, mode_Hz, damping in ((4.8, 72.0, 0.02), (1.0, 150.0, 0.02)):
        w = 2 * np.pi * mode_Hz
        A, B = np.array([[0.0, 1.0], [-w * w, -2 * damping * w]]), np.array([[0.0], [w * w]])
        parts.append(cont2discrete((A, B, np.array([[gain, 0.0]]), np.zeros((1, 1))), period_s))
    (A, B, C, *_), (A2, B2, C2, *_) = parts
    model = System(block_diag(A, A2), np.concatenate([B, B2])[:, 0], np.concatenate([C, C2], axis=1)[0], 0.0, period_s)
    said = commissioned(model)
    omega = 2 * np.pi * HERTZ
    seen = plant_figures(measured(model.response(omega) * np.exp(-1j * omega * 2e-4)), None, said)
    for name in ("stage_gain", "mode_Hz", "mode_damping"):
        assert getattr(said, name) == pytest.approx(getattr(seen, name), rel=0.01), name
    at_rest = model.response(np.array([2 * np.pi]))[0].real
    assert said.stage_gain < 0.95 * at_rest, "else the case asks for nothing"


def run(values, limit=4.0):
    cusum, sums = Cusum(limit), []
    for value in values:
        cusum.add(value)
        sums.append((cusum.upper, cusum.lower))
    return cusum, np.array(sums)


@pytest.mark.parametrize(("limit", "known"), [(3.0, 117.6), (4.0, 335.4), (5.0, 930.9)])
def test_run_lengths_are_those_of_the_tables(limit, known):
    """One-sided, allowance .5: Hawkins and Olwell (1998) by a Markov chain."""
    assert average_run_length(limit) == pytest.approx(known, rel=0.02)
    assert limit_for(known) == pytest.approx(limit, rel=0.01)


def test_without_a_shift_it_alarms_as_rarely_as_said():
    """Also from the third value on, without any time of learning."""
    wanted, rng, lengths = 20.0, np.random.default_rng(3), []
    limit = limit_for(2 * wanted)
    for _ in range(150):
        cusum, length = Cusum(limit), 0
        while cusum.crossed is None and length < 200:
            cusum.add(rng.normal(5.0, 0.1))
            length += 1
        lengths.append(length)
    assert np.mean(lengths) == pytest.approx(wanted, rel=0.25)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_shift_is_found_and_its_beginning_named(sign):
    values = np.random.default_rng(1).normal(0.0, 1.0, 40)
    values[25:] += sign * 4.0
    cusum, _ = run(values, limit_for(2000.0))
    assert 25 <= cusum.crossed <= 28
    assert abs(change_point(values[: cusum.crossed + 1]) - 25) <= 1


TUNED = PlantFigures(5.0, 67.0, 0.02)
FIGURES = dict(zip(COLUMNS, (5.0, 67.0, 0.02, 0.61, 7.5, 37.0), strict=True))
SCATTER = dict(zip(COLUMNS, (0.004, 0.003, 0.1, 0.006, 0.015, 0.007), strict=True))
"""As on the simulated cell."""


def series(count, seed=1, **trends):
    """Checks with the scatter of the simulated cell; `trends` are factors a check from the tenth on."""
    rng = np.random.default_rng(seed)
    return [
        Check(
            datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=k),
            "x",
            "abc",
            {
                name: value * (1 + SCATTER[name] * rng.normal()) * trends.get(name, 1.0) ** max(0, k - 9)
                for name, value in FIGURES.items()
            },
        )
        for k in range(count)
    ]


def test_what_stays_as_it_was_is_nothing_to_speak_of():
    """But for false alarms, of which one in a thousand checks is asked for and .6 are expected here."""
    told = [judge(series(30, seed), TUNED, Accept()).problems for seed in range(20)]
    assert sum(map(bool, told)) <= 2


def test_a_drift_of_a_few_scatters_a_check_is_named_with_its_beginning():
    found = judge(series(18, mode_Hz=0.995), TUNED, Accept())
    assert len(found.problems) == 1
    assert found.problems[0].startswith("mode_Hz drifts since 2026-01-1")
    by_name = {each.name: each for each in found.watched}
    assert by_name["mode_Hz"].before == pytest.approx(67.0, rel=0.005)
    assert by_name["mode_Hz"].change == pytest.approx(0.995**8 - 1, abs=0.01)
    assert by_name["stage_gain"].since is None


def test_margins_below_and_on_their_way_there():
    edge = [Check(c.time, "x", "abc", c.figures | {"stage_phase_deg": 34.7}) for c in series(5)]
    assert judge(edge, TUNED, Accept()).problems == (), "a check knows a margin to some 2 %"
    below = [Check(c.time, "x", "abc", c.figures | {"stage_phase_deg": 32.0}) for c in series(5)]
    assert judge(below, TUNED, Accept()).problems == (
        "stage_phase_deg is 32, 32 on average over 3 checks: at least 35 is asked for (`accept`)",
    )  # fmt: skip
    phases = zip(series(3), (37.0, 37.0, 3.0), strict=True)
    fallen = [Check(c.time, "x", "abc", c.figures | {"stage_phase_deg": phase}) for c, phase in phases]
    assert judge(fallen, TUNED, Accept()).problems == (
        "stage_phase_deg is 3, 25.7 on average over 3 checks: at least 35 is asked for (`accept`)",
    )  # fmt: skip
    (said,) = judge(below[:1], TUNED, Accept()).problems
    assert said == "stage_phase_deg is 32: at least 35 is asked for (`accept`)"
    falling = [
        Check(c.time, "x", "abc", c.figures | {"stage_phase_deg": 39.0 - 0.3 * k}) for k, c in enumerate(series(9))
    ]
    assert judge(falling, TUNED, Accept()).problems == (
        "stage_phase_deg falls by 0.3 a check: its limit, 35, is some 6 checks away",
    )  # fmt: skip


def test_a_margin_that_is_not_surely_below_is_no_alarm():
    """On another make of stage 5.4 dB were told where 7.2 were true: 5 s know it to 1 dB there."""

    def checks(count, deviation_dB):
        figures = FIGURES | {"stage_gain_dB": 5.2}
        return [Check(c.time, "x", "abc", figures, {"stage_gain_dB": deviation_dB}) for c in series(count)]

    assert judge(checks(1, 0.9), TUNED, Accept()).problems == ()
    assert judge(checks(3, 0.9), TUNED, Accept()).problems == ()
    (said,) = judge(checks(3, 0.6), TUNED, Accept()).problems
    assert said.startswith("stage_gain_dB is 5.2, known to 1.2, 5.2 on average over 3 checks: at least 6 is asked for")
    assert len(judge(checks(1, 0.1), TUNED, Accept()).problems) == 1


def test_the_history_is_read_as_it_was_written(tmp_path):
    file, checks = tmp_path / "drift.csv", series(3)
    checks[1].figures["mode_Hz"] = math.nan
    for check in checks:
        append(file, check)
    found = read_history(file)
    assert [(c.time, c.axis, c.tuning) for c in found] == [(c.time, c.axis, c.tuning) for c in checks]
    for name in COLUMNS:
        expected = [c.figures[name] for c in checks]
        assert [c.figures[name] for c in found] == pytest.approx(expected, rel=1e-6, nan_ok=True)
    assert read_history(tmp_path / "none.csv") == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time;axis;tuning\n", r"drift.csv:1: no history of `micromanip analyse health`: its first line is time,axis"),
        (",".join(HEADER) + "\n2026-01-01T00:00:00+00:00,x,abc,5\n", r"drift.csv:2: 4 fields, 9 are expected"),
        (",".join(HEADER) + "\nyesterday,x,abc,,,,,,\n", r"drift.csv:2: time: 'yesterday' is no time like"),
        (",".join(HEADER) + '\n2026-01-01,x,abc,"5,1",,,,,\n', r"drift.csv:2: stage_gain: '5,1' is not a number"),
    ],
)  # fmt: skip
def test_what_is_no_history_is_refused_and_left_as_it_is(tmp_path, text, said):
    file = tmp_path / "drift.csv"
    file.write_text(text)
    with pytest.raises(CheckFailed, match=said):
        append(file, series(1)[0])
    assert file.read_text() == text
