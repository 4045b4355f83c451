"""The actuator's linear dynamics, undone: resonances before the inverse, the amplifier's lag behind it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from micromanip.rt.laws.feedforward import HYSTERESIS_PARAMETERS, HYSTERESIS_STATE, start_feedforward
from micromanip.rt.laws.resonance import MAX_RESONANCES
from micromanip.settings.compile.hysteresis import fill_hysteresis
from micromanip.settings.schema.actuator import Actuator, Resonance
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii

from .builders import PERIOD_S, courses, record
from .kernels import feedforward_course, resonance_course

STAGE = Resonance(resonance_Hz=63.0, resonance_damping=0.04, antiresonance_Hz=67.0, antiresonance_damping=0.038)
SECOND = Resonance(resonance_Hz=231.0, resonance_damping=0.01, antiresonance_Hz=220.0, antiresonance_damping=0.012)
LINEAR = PrandtlIshlinskii(
    model="pi", shaping="affine", coefficients=(0.8, 0.0), thresholds_um=(), weights=(), range_um=(-1e4, 1e4)
)
UM = st.floats(-50.0, 50.0)


def parameters(*resonances, lag_us=None, period_s=PERIOD_S):
    p = record(HYSTERESIS_PARAMETERS)
    fill_hysteresis(p, LINEAR, period_s, Actuator(resonances=resonances, lag_us=lag_us))
    return p


def along(p, x, s=None):
    out = np.zeros(len(x))
    resonance_course(p, record(HYSTERESIS_STATE) if s is None else s, np.asarray(x, dtype=float), out)
    return out


def voltages(p, setpoint, s=None):
    out = np.zeros(len(setpoint))
    feedforward_course(p, record(HYSTERESIS_STATE) if s is None else s, np.asarray(setpoint, dtype=float), out)
    return out


@st.composite
def resonances(draw):
    """Any pair that lies below 0.45 times the rate."""
    pole, zero = (draw(st.floats(1.0, 4500.0)) for _ in range(2))
    ratios = [draw(st.floats(1e-3, 2.0)) for _ in range(2)]
    return Resonance(
        resonance_Hz=pole, resonance_damping=ratios[0], antiresonance_Hz=zero, antiresonance_damping=ratios[1]
    )


def actuator(*pairs, period_s=PERIOD_S):
    """scipy's (b, a) of what is to be undone, by the bilinear transform with each frequency warped by itself."""
    b, a = np.ones(1), np.ones(1)
    for each in pairs:
        sections = []
        for frequency, ratio in (
            (each.antiresonance_Hz, each.antiresonance_damping),
            (each.resonance_Hz, each.resonance_damping),
        ):
            w = 2.0 / period_s * np.tan(np.pi * frequency * period_s)
            sections.append(np.array([1.0, 2.0 * ratio * w, w * w]) / (w * w))
        numerator, denominator = signal.bilinear(*sections, fs=1.0 / period_s)
        b, a = np.convolve(b, numerator), np.convolve(a, denominator)
    return b, a


@given(st.lists(resonances(), min_size=1, max_size=MAX_RESONANCES), courses(UM, most=150))
def test_what_the_actuator_does_to_it_is_undone(pairs, x):
    """After scipy's filter with the poles and zeros the other way round nothing is left but what went in."""
    asked = along(parameters(*pairs), x)
    for each in pairs:
        asked = signal.lfilter(*actuator(each), asked)
    scale = np.abs(x).max() * np.prod([max(1.0, (e.antiresonance_Hz / e.resonance_Hz) ** 2) for e in pairs])
    assert asked == pytest.approx(x, abs=1e-6 * scale + 1e-9)


@pytest.mark.parametrize("pairs", [(STAGE,), (STAGE, SECOND)])
@pytest.mark.parametrize("rate_Hz", [2_000.0, 10_000.0, 20_000.0])
def test_the_response_is_that_of_the_equation(pairs, rate_Hz):
    """Of the analogue one, to what its bilinear transform bends below a twentieth of the rate."""
    omega = 2 * np.pi * np.array([1.0, 30.0, 63.0, 67.0, 90.0])
    s = 1j * omega
    expected = np.ones(len(omega), complex)
    for each in pairs:
        p, z = 2 * np.pi * each.resonance_Hz, 2 * np.pi * each.antiresonance_Hz
        expected *= (z / p) ** 2 * (s * s + 2 * each.resonance_damping * p * s + p * p)
        expected /= s * s + 2 * each.antiresonance_damping * z * s + z * z
    impulse = np.zeros(round(3.0 * rate_Hz))
    impulse[0] = 1.0
    out = along(parameters(*pairs, period_s=1.0 / rate_Hz), impulse)
    measured = np.exp(-1j * np.outer(omega / rate_Hz, np.arange(len(out)))) @ out
    assert measured == pytest.approx(expected, rel=0.02)


@given(st.floats(5.0, 5000.0), courses(UM, most=100))
def test_the_amplifiers_lag_is_undone_a_cycle_late(lag_us, setpoint):
    """A first-order lag that is driven by voltages held for a cycle each, as (1 - e^(-h/tau)): exact, not nearly."""
    p = parameters(lag_us=lag_us)
    setpoint = np.concatenate([setpoint[:1], setpoint])  # it begins at rest
    driven = voltages(p, setpoint)
    left = np.exp(-PERIOD_S / (1e-6 * lag_us))
    reached = setpoint[0] / 0.8
    for voltage, wanted in zip(driven, setpoint / 0.8, strict=True):
        reached = left * reached + (1.0 - left) * voltage
        assert reached == pytest.approx(wanted, abs=1e-8 * (1.0 + lag_us))


@given(st.lists(resonances(), max_size=MAX_RESONANCES), st.one_of(st.none(), st.floats(5.0, 500.0)), UM)
def test_it_starts_where_it_is_without_a_kick(pairs, lag_us, um):
    p, s = parameters(*pairs, lag_us=lag_us), record(HYSTERESIS_STATE)
    voltages(p, [0.0, 50.0, -50.0], s)
    start_feedforward(p, s, um, um / 0.8)
    assert voltages(p, [um, um, um], s) == pytest.approx([um / 0.8] * 3, abs=1e-8)


@given(courses(UM))
def test_without_a_section_not_a_bit_is_another(setpoint):
    plain, empty = record(HYSTERESIS_PARAMETERS), record(HYSTERESIS_PARAMETERS)
    fill_hysteresis(plain, LINEAR, PERIOD_S)
    fill_hysteresis(empty, LINEAR, PERIOD_S, Actuator())
    states = [record(HYSTERESIS_STATE), record(HYSTERESIS_STATE)]
    volts = [voltages(p, setpoint, s).tolist() for p, s in zip((plain, empty), states, strict=True)]
    assert volts[0] == volts[1] == [um / 0.8 for um in setpoint]
    assert states[0].tobytes() == states[1].tobytes()
    assert plain["identity"] == empty["identity"]
