"""What is chosen predicts no worse than ARX(1), is judged strictly, and what was replaced is told."""

import re

import numpy as np
import pytest
from scipy.signal import lfilter

from micromanip.design.identify.linear import fit_linear
from micromanip.design.identify.linear.model import strict_errors
from micromanip.design.identify.linear.selection import error_of, fit_arx1, select
from tests.further import further

DT = 1e-3


def experiment(seed, samples=1500, noise=0.02, drift=0.0):
    """A lightly damped mode behind a lag, driven by noise; the sensor may wander."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((samples, 1))
    poles = 0.97 * np.exp(np.array([0.2j, -0.2j]))
    y = lfilter([0.0, 0.1], np.poly([*poles, 0.6]).real, u, axis=0)
    wander = drift * np.cumsum(rng.standard_normal((samples, 1)), axis=0)
    return u, 5.0 + y + noise * y.std() * rng.standard_normal(y.shape) + wander * y.std()


def test_arx1_is_that_of_least_squares():
    """Beside numpy's solution for one output, with an offset."""
    rng = np.random.default_rng(1)
    u = rng.standard_normal((800, 2))
    y = lfilter([0.0, 1.0], [1.0, -0.8], u @ np.array([[0.5], [-0.2]]), axis=0) + 3.0
    y += 0.05 * rng.standard_normal(y.shape)
    model = fit_arx1([(u, y)], DT, (0, 0))
    table = np.column_stack([y[:-1, 0], u[:-1], np.ones(799)])
    a, b1, b2, _ = np.linalg.lstsq(table, y[1:, 0], rcond=None)[0]
    assert model.poles[0].real == pytest.approx(a, rel=1e-6)
    np.testing.assert_allclose(model.modes.B[0].real, [b1, b2], rtol=1e-6)
    run, at = np.empty(800), y[0, 0] - y.mean()
    for k in range(800):
        run[k] = at
        at = a * at + (u[k] - u.mean(axis=0)) @ [b1, b2]
    np.testing.assert_allclose(
        model.simulate(u, y)[100:, 0] - model.simulate(u, y)[-1, 0], run[100:] - run[-1], atol=0.02
    )


def test_the_strict_error_does_not_see_what_it_is_judged_by():
    """The start is fitted to the first tenth: what comes later moves the error, not the run."""
    u, y = experiment(2)
    model = fit_linear([(u, y)], DT, 3)
    other_u, other_y = experiment(3)
    usual, strict = model.errors(other_u, other_y)[1], strict_errors(model, [(other_u, other_y)])
    assert strict == pytest.approx(usual, rel=0.1)
    late = other_y.copy()
    late[800:] += 2.0 * other_y.std()
    before, seen = model.errors(other_u, late)[1], strict_errors(model, [(other_u, late)])
    assert seen > 1.2 * before, "an offset that comes late can't be fitted away"
    np.testing.assert_array_less(strict, seen)


@pytest.mark.parametrize("seed", [0, 1, *further(2, 3, 4, 5)])
@pytest.mark.parametrize(
    ("noise", "drift", "samples"), [(0.02, 0.0, 600), (0.5, 0.0, 300), (0.1, 0.2, 600), (3.0, 0.1, 240)]
)
def test_nothing_chosen_is_worse_than_arx1(seed, noise, drift, samples):
    u, y = experiment(seed, 2 * samples, noise, drift)
    first, rest = (u[:samples], y[:samples]), (u[samples:], y[samples:])
    selected = select([first], [rest], DT, None)
    assert error_of(selected.model, [rest]) <= error_of(selected.arx1, [rest]) * (1.0 + 1e-6)
    replaced = selected.model.order != fit_linear([first], DT).order
    assert not replaced or selected.notes, "what was replaced is told"


def test_an_order_that_was_asked_for_is_kept_and_judged():
    u, y = experiment(4, 400, 3.0, 0.3)
    selected = select([(u[:200], y[:200])], [(u[200:], y[200:])], DT, 8)
    assert selected.model.order == 8
    worse = error_of(selected.model, [(u[200:], y[200:])]) > error_of(selected.arx1, [(u[200:], y[200:])])
    assert worse == any("order 8 predicts worse than ARX(1)" in note for note in selected.notes)


def test_the_order_of_a_single_blow_is_chosen_where_it_is_answered():
    """In the last quarter, and in the half held out, nothing moves: all orders are alike there."""
    rng = np.random.default_rng(0)
    u = np.zeros((6000, 1))
    u[40:194, 0] = 250 * np.sin(np.pi * (np.arange(154) + 0.5) / 154)
    y = 0.2 * rng.standard_normal((6000, 1))
    for p in 0.98 * np.exp(1j * np.array([0.13, 0.24])):
        y += lfilter([0.0, 0.3, -0.3], [1.0, -2.0 * p.real, abs(p) ** 2], u, axis=0)
    selected = select([(u[:3000], y[:3000])], [(u[3000:], y[3000:])], DT, None)
    assert selected.model.order == 4
    assert np.abs(selected.model.poles) == pytest.approx(0.98, abs=2e-3)
    assert [note.split(":")[0] for note in selected.notes] == [
        "order 4 is chosen by the error on all that is fitted to, as little moves in its last quarter",
        "in the part held out hardly anything moves, so its figures say little",
    ]


@pytest.mark.parametrize(("wave", "told"), [("sine", 1), ("step", 0), ("triangle", 0), ("noise", 0)])
def test_an_input_of_one_frequency_is_told(wave, told):
    phase = 2 * np.pi * 13.0 * DT * np.arange(1500)
    u = {"sine": np.sin(phase), "step": 1.0 * (phase > 3.0), "triangle": np.arcsin(np.sin(phase))}
    driven = (u[wave] if wave in u else np.random.default_rng(1).standard_normal(1500))[:, None]
    noise = 1e-3 * np.random.default_rng(2).standard_normal((1500, 1))
    experiment = driven, lfilter([0.0, 0.1], [1.0, -0.9], driven, axis=0) + noise
    notes = select([experiment], [experiment], DT, 1).notes
    assert [note for note in notes if "Hz only" in note] == told * [
        "input 1 moves at 13 Hz only: what the model says of other frequencies is a guess"
    ]


@pytest.mark.parametrize("stable", [False, True])
def test_an_unstable_plant_in_a_closed_loop_is_told(stable):
    rng = np.random.default_rng(1)
    x = v = r = 0.0
    rows = []
    for k in range(2000):
        r = 0.02 * rng.standard_normal() if k % 40 == 0 else r
        y = x + 1e-4 * rng.standard_normal()
        u = -60 * (y - r) - 8 * v + 0.3 * rng.standard_normal()
        rows.append((u, y))
        v += 0.01 * ((-20 if stable else 20) * x + u)
        x += 0.01 * v
    table = np.array(rows)
    parts = [(table[part, :1], table[part, 1:]) for part in (slice(1000), slice(1000, 2000))]
    notes = select(parts[:1], parts[1:], 0.01, None).notes
    told = [
        note for note in notes if re.search("unstable pole, z = 1.04.* mirrored to 0.95.*the loop's set-point", note)
    ]
    assert len(told) == (not stable)
