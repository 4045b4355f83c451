"""Prandtl-Ishlinskii model (6), its inverse (7)-(9), the map between their states."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.rt.laws import hysteresis as law
from micromanip.rt.laws.feedforward import HYSTERESIS_STATE, feedforward_voltage, start_feedforward
from micromanip.rt.laws.hysteresis import SHAPING, admit, inverse_plays, inverse_state, model_output, shape, unshape

from .builders import VOLTS, admissible, courses, hysteresis, models, plays, record, shapes
from .kernels import inverse_course, model_course

# like the fitted one of config/simulated.yaml, and one with negative weights
TANH = {"kind": law.TANH, "c": [121.58, 0.005505, -0.3134, 32.39]}


def predicted(p, w, v):
    out = np.zeros(len(v))
    model_course(p, w, np.asarray(v, dtype=float), out)
    return out


def inverted(p, z, y):
    out = np.zeros(len(y))
    inverse_course(p, z, np.asarray(y, dtype=float), out)
    return out


# -- the inverse undoes the model -----------------------------------------------------------------


@given(models(), courses())
def test_inverse_of_the_model_is_the_identity(p, v):
    y = predicted(p, plays(), v)
    assert inverted(p, plays(), y) == pytest.approx(v, rel=0, abs=1e-9)


@given(models(), courses())
def test_model_of_the_inverse_is_the_identity(p, v):
    y = predicted(p, plays(), v)  # displacements that the model can reach
    again = predicted(p, plays(), inverted(p, plays(), y))
    assert again == pytest.approx(y, rel=1e-12, abs=1e-9)


@given(st.data(), models(), VOLTS, courses())
def test_inverse_from_any_admissible_state(data, p, v0, v):
    w = data.draw(admissible(p, shape(p["shaping"], v0)))
    z = plays()
    inverse_state(p, w, z)
    y = predicted(p, w, [v0, *v])
    assert inverted(p, z, y) == pytest.approx(np.array([v0, *v]), rel=0, abs=1e-9)


@given(models(), courses(), courses())
def test_state_map_along_a_history(p, before, after):
    """The inverse that ran along has, at any time, the state that the map gives."""
    w, z, mapped = plays(), plays(), plays()
    inverted(p, z, predicted(p, w, before))
    inverse_state(p, w, mapped)
    n = p["plays"]
    assert z[:n] == pytest.approx(mapped[:n], rel=1e-12, abs=1e-9)


# -- against the formulas as printed, in exact arithmetic ---------------------------------------------


@given(models(shape=st.just({"kind": law.IDENTITY})))
def test_inverse_parameters_are_equations_8_and_9(p):
    n = p["plays"]
    alpha, r, rho = (
        Fraction(float(p["alpha"])),
        [Fraction(float(x)) for x in p["r"]],
        [Fraction(float(x)) for x in p["rho"]],
    )
    for i in range(n):
        r_hat = alpha * r[i] + sum((rho[j] * (r[i] - r[j]) for j in range(i)), Fraction(0))
        rho_hat = -rho[i] / ((alpha + sum(rho[: i + 1])) * (alpha + sum(rho[:i])))
        assert p["r_hat"][i] == pytest.approx(float(r_hat), rel=1e-12, abs=1e-12)
        assert p["rho_hat"][i] == pytest.approx(float(rho_hat), rel=1e-9, abs=1e-12)
    assert (np.diff(p["r_hat"][:n]) > 0).all()


def _play(u, r, w):
    return max(u - r, min(u + r, w))


@given(models(shape=st.just({"kind": law.AFFINE, "c": [1.5, -7.0]})), courses())
def test_model_and_inverse_in_plain_python(p, v):
    """Equations (6) and (7) written out, each play on its own along the whole signal."""
    n = p["plays"]
    phi = [1.5 * x - 7.0 for x in v]
    y = [p["alpha"] * u for u in phi]
    for i in range(n):
        w = 0.0
        for k, u in enumerate(phi):
            w = _play(u, p["r"][i], w)
            y[k] += p["rho"][i] * w
    assert predicted(p, plays(), v) == pytest.approx(np.array(y), rel=1e-12, abs=1e-10)
    u = [value / p["alpha"] for value in y]
    for i in range(n):
        z = 0.0
        for k, value in enumerate(y):
            z = _play(value, p["r_hat"][i], z)
            u[k] += p["rho_hat"][i] * z
    assert inverted(p, plays(), y) == pytest.approx((np.array(u) + 7.0) / 1.5, rel=1e-12, abs=1e-10)


# -- admissible states -----------------------------------------------------------------------------


@given(models(), st.floats(-200.0, 200.0), st.lists(st.floats(-300.0, 300.0), min_size=8, max_size=8))
def test_admit_projects_onto_the_admissible_states(p, y, start):
    n = p["plays"]
    z = plays()
    z[:8] = start
    admit(p, z, y)
    chain = np.concatenate([[y], z[:n]])
    room = np.diff(np.concatenate([[0.0], p["r_hat"][:n]]))
    assert (np.abs(np.diff(chain)) <= room + 1e-10).all()
    again = z.copy()
    admit(p, again, y)
    assert (again == z).all()
    # the inverse, fed with the same displacement, has nothing to move
    moved = z.copy()
    inverse_plays(p, moved, y, 0.0)
    assert moved[:n] == pytest.approx(z[:n], rel=0, abs=1e-10)


@given(models(), courses())
def test_admit_leaves_admissible_states_alone(p, v):
    z = plays()
    y = predicted(p, plays(), v)
    inverted(p, z, y)
    admitted = z.copy()
    admit(p, admitted, y[-1])
    assert admitted == pytest.approx(z, rel=0, abs=1e-10)


# -- shaping ----------------------------------------------------------------------------------------


@given(shapes(), courses(st.floats(-60.0, 200.0)))
def test_shaping_is_increasing_and_invertible(fields, v):
    s = hysteresis([], [], 1.0, fields)["shaping"]
    v = np.unique(np.round(v, 3))
    u = np.array([shape(s, x) for x in v])
    assert (np.diff(u) > 0).all()
    assert np.array([unshape(s, x) for x in u]) == pytest.approx(v, rel=0, abs=1e-9)


def test_shaping_functions_are_15_and_16():
    v = np.array([-20.0, 0.0, 33.0, 150.0])

    def values(**fields):
        s = record(SHAPING, **fields)
        return np.array([shape(s, x) for x in v])

    assert values(kind=law.IDENTITY) == pytest.approx(v)
    assert values(kind=law.AFFINE, c=[0.65, -2.8]) == pytest.approx(0.65 * v - 2.8)
    assert values(kind=law.TANH, c=[121.6, 0.0055, -0.31, 32.4]) == pytest.approx(
        121.6 * np.tanh(0.0055 * v - 0.31) + 32.4
    )


@given(
    st.lists(st.floats(0.5, 20.0), min_size=1, max_size=20),
    st.lists(st.floats(0.5, 20.0), min_size=20, max_size=20),
    courses(st.floats(-100.0, 300.0)),
)
def test_table_is_linear_interpolation_extended_at_both_ends(dv, du, v):
    points = len(dv) + 1
    x, y = np.cumsum([-20.0, *dv]), np.cumsum([-5.0, *du])[:points]
    s = record(SHAPING, kind=law.TABLE, points=points, v=x, u=y)
    inside = np.interp(v, x, y)
    below = y[0] + (v - x[0]) * (y[1] - y[0]) / (x[1] - x[0])
    above = y[-1] + (v - x[-1]) * (y[-1] - y[-2]) / (x[-1] - x[-2])
    expected = np.where(v < x[0], below, np.where(v > x[-1], above, inside))
    assert np.array([shape(s, value) for value in v]) == pytest.approx(expected, rel=1e-12, abs=1e-9)


@given(st.floats(-1e300, 1e300), st.sampled_from([1.0, -1.0]))
def test_tanh_guard_stays_finite(u, sign):
    s = record(SHAPING, kind=law.TANH, c=[sign * 121.6, sign * 0.0055, -0.31, 32.4])
    v = unshape(s, u)
    assert np.isfinite(v)
    low, high = unshape(s, 32.4 - 121.6), unshape(s, 32.4 + 121.6)
    assert low <= v <= high


# -- feedforward: clip before the inverse -------------------------------------------------------------


def feedforward_course(p, s, y):
    return np.array([feedforward_voltage(p, s, value) for value in y])


def test_set_point_is_clipped_before_the_inverse():
    """An excursion beyond the range leaves the same memory as one that goes just up to it."""
    p = hysteresis([6.0, 12.0, 18.0], [0.11, 0.1, 0.1], 1.0, TANH, low_um=5.0, high_um=120.0)
    way_back = [100.0, 60.0, 20.0]
    states = [record(HYSTERESIS_STATE) for _ in range(3)]
    beyond = feedforward_course(p, states[0], [50.0, 500.0, *way_back])
    just = feedforward_course(p, states[1], [50.0, 120.0, *way_back])
    assert (beyond == just).all()
    assert (states[0]["z"] == states[1]["z"]).all()
    assert states[0]["output_V"] == beyond[-1]
    low = feedforward_course(p, states[2], [50.0, -1e9])
    assert low[-1] == feedforward_course(p, record(HYSTERESIS_STATE), [50.0, 5.0])[-1]


# -- creep and rate dependence ---------------------------------------------------------------------


def extended(p, rate_cycles=0.0, gains=(), steps=()):
    p["rate_cycles"], p["creeps"] = rate_cycles, len(gains)
    p["creep_gain"][: len(gains)], p["creep_step"][: len(steps)] = gains, steps
    return p


def with_creep_and_rate(p, v):
    """The forward model in plain Python: thresholds grow with the speed of phi(v), lags of phi(v) are added."""
    n, creeps = int(p["plays"]), int(p["creeps"])
    w, lags = [0.0] * n, [0.0] * creeps
    u_before, change, y = 0.0, 0.0, []
    for value in v:
        u = float(shape(p["shaping"], float(value)))
        wider = p["rate_cycles"] * abs(change)
        w = [_play(u, p["r"][i] + wider, w[i]) for i in range(n)]
        total = p["alpha"] * u + sum(p["rho"][i] * w[i] for i in range(n))
        y.append(total + sum(p["creep_gain"][m] * lags[m] for m in range(creeps)))
        lags = [lags[m] + p["creep_step"][m] * (u - lags[m]) for m in range(creeps)]
        u_before, change = u, u - u_before
    return np.array(y)


@given(
    models(),
    courses(),
    st.floats(0.0, 0.5),
    st.lists(st.tuples(st.floats(-0.02, 0.05), st.floats(1e-4, 0.5)), max_size=8),
)
def test_inverse_with_creep_and_rate_dependence_undoes_its_model(p, v, rate_cycles, creep):
    extended(p, rate_cycles, [g for g, _ in creep], [a for _, a in creep])
    y, s = with_creep_and_rate(p, v), record(HYSTERESIS_STATE)
    assert feedforward_course(p, s, y) == pytest.approx(v, rel=0, abs=1e-7)


def test_creep_starts_in_balance():
    """Taken over at rest, with all creep behind it, a set-point held needs no change of voltage."""
    p = extended(hysteresis([6.0, 12.0], [0.11, 0.1], 1.0, TANH), 0.0, [0.03, 0.02], [1e-3, 1e-4])
    s = record(HYSTERESIS_STATE)
    u = shape(p["shaping"], 70.0)
    w = np.zeros(32)
    y = model_output(p, w, 70.0) + 0.05 * u  # up from 0, and long at rest
    start_feedforward(p, s, y, 70.0)
    held = feedforward_course(p, s, [y] * 200)
    assert np.ptp(held) < 1e-3
    assert held[0] == pytest.approx(70.0, abs=1e-6)
    assert s["change_um"] == pytest.approx(0.0, abs=1e-6)
