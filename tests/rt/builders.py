"""Small records for the laws' tests, in physical units."""

import numpy as np
from hypothesis import strategies as st

from micromanip.rt.laws import hysteresis as law
from micromanip.rt.laws.feedforward import HYSTERESIS_PARAMETERS, PRANDTL_ISHLINSKII
from micromanip.rt.laws.hysteresis import MAX_PLAYS, inverse_parameters
from micromanip.rt.laws.pid import PID_PARAMETERS, PID_STATE
from micromanip.rt.laws.saturation import LIMITER_PARAMETERS

PERIOD_S = 1e-4


def record(dtype, **fields):
    """One record of `dtype`; a shorter list fills the first places of its field."""
    r = np.zeros(1, dtype)[0]
    for name, value in fields.items():
        if np.ndim(value):
            r[name][tuple(slice(n) for n in np.shape(value))] = value
        else:
            r[name] = value
    return r


def limiter(low_V=-20.0, high_V=150.0, slew_V=4.0, park_V=0.0):
    return record(LIMITER_PARAMETERS, low_V=low_V, high_V=high_V, slew_V=slew_V, park_V=park_V)


def pid(K=0.6, Ti_s=0.571e-3, Td_s=0.167e-3, filter_s=0.3e-3, tracking=0.1, period_s=PERIOD_S, most_periods=1000):
    """Parameters of (17), by default the anchor PID of the simulated plant, and a sensor of any rate."""
    return record(
        PID_PARAMETERS,
        K_V_per_um=K,
        integral=K * period_s / Ti_s,
        derivative=K * Td_s,
        filter_s=filter_s,
        period_s=period_s,
        tracking=tracking,
        most_periods=most_periods,
    )


def pid_state(**fields):
    return record(PID_STATE, **fields)


def hysteresis(r, rho, alpha=1.0, shape=None, low_um=-1e6, high_um=1e6):
    """Prandtl-Ishlinskii model and inverse; `shape` is a dict of SHAPING fields."""
    model = {"kind": PRANDTL_ISHLINSKII, "plays": len(r), "alpha": alpha, "r": r, "rho": rho}
    p = record(HYSTERESIS_PARAMETERS, **model, low_um=low_um, high_um=high_um)
    for name, value in (shape or {}).items():
        if np.ndim(value):
            p["shaping"][name][: len(value)] = value
        else:
            p["shaping"][name] = value
    inverse_parameters(p)
    return p


def plays():
    """Fresh play states."""
    return np.zeros(MAX_PLAYS)


# -- what hypothesis draws ------------------------------------------------------------------------

VOLTS = st.floats(-20.0, 150.0)


def courses(values=VOLTS, most=40):
    """Signals as arrays."""
    return st.lists(values, min_size=1, max_size=most).map(np.array)


@st.composite
def shapes(draw):
    """Every kind of shaping function, with parameters for -20..150 V."""
    kind = draw(st.sampled_from([law.IDENTITY, law.AFFINE, law.TANH, law.TABLE]))
    if kind == law.AFFINE:
        return {"kind": kind, "c": [draw(st.floats(0.2, 3.0)), draw(st.floats(-50.0, 50.0))]}
    if kind == law.TANH:
        sign = draw(st.sampled_from([1.0, -1.0]))
        steepness, offset = draw(st.floats(0.002, 0.01)), draw(st.floats(-1.0, 0.5))
        return {
            "kind": kind,
            "c": [sign * draw(st.floats(40.0, 200.0)), sign * steepness, sign * offset, draw(st.floats(-50.0, 50.0))],
        }
    if kind == law.TABLE:
        steps = draw(st.lists(st.tuples(st.floats(2.0, 30.0), st.floats(1.0, 30.0)), min_size=1, max_size=10))
        v = np.cumsum([draw(st.floats(-30.0, 0.0)), *(dv for dv, _ in steps)])
        u = np.cumsum([draw(st.floats(-30.0, 0.0)), *(du for _, du in steps)])
        return {"kind": kind, "points": len(v), "v": v, "u": u}
    return {"kind": kind}


@st.composite
def models(draw, shape=None):
    """Invertible models: thresholds rise, partial sums are positive, single weights may be negative."""
    increments = draw(st.lists(st.floats(0.2, 10.0), min_size=0, max_size=8))
    sums = draw(st.lists(st.floats(0.3, 3.0), min_size=len(increments) + 1, max_size=len(increments) + 1))
    return hysteresis(np.cumsum(increments), np.diff(sums), sums[0], draw(shape if shape is not None else shapes()))


@st.composite
def admissible(draw, p, u):
    """Play states that some history ending at `u` could have left behind."""
    w, inner, r_inner = plays(), u, 0.0
    for i in range(p["plays"]):
        inner += draw(st.floats(-1.0, 1.0)) * (p["r"][i] - r_inner)
        w[i], r_inner = inner, p["r"][i]
    return w
