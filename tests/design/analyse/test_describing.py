"""Describing function (18)-(24): closed form, quadrature, and the loop's own inverse agree; stairs; singularities."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.design.analyse.describing import (
    actuator_operator,
    amplitudes_up_to,
    gain_map,
    harmonics,
    inverse_operator,
    judge,
    limit_cycles,
    sweep,
)
from micromanip.design.identify.hysteresis import inverse
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii, attainable_um
from tests.design.actuators import predict

OMEGA = np.geomspace(0.01, 100.0, 400)
AMPLITUDES = np.geomspace(0.01, 10.0, 200)


def third_order(omega):
    s = 1j * np.asarray(omega)
    return 1.0 / (s * (s + 1.0) * (s + 2.0))


def relay(amplitude, height=1.0):
    return 4.0 * height / (np.pi * amplitude) + 0j


def test_relay_on_an_integrator_with_two_lags():
    """L crosses the negative axis at sqrt 2 with 1/6: A = 4 / (6 pi)."""
    (cycle,) = limit_cycles(relay, AMPLITUDES, third_order, OMEGA)
    assert cycle.amplitude == pytest.approx(4.0 / (6.0 * np.pi), rel=1e-8)
    assert cycle.frequency_Hz == pytest.approx(np.sqrt(2.0) / (2 * np.pi), rel=1e-8)
    assert cycle.residual < 1e-8


def test_relay_with_hysteresis_on_an_integrator_with_a_lag():
    """N = 4/(pi A^2) (sqrt(A^2 - d^2) - i d): solved for A and w by hand on L = 1/(s (s + 1))."""
    width = 0.1

    def element(amplitude):
        if amplitude <= width:
            return complex(np.nan, np.nan)
        return 4.0 / (np.pi * amplitude**2) * complex(np.sqrt(amplitude**2 - width**2), -width)

    (cycle,) = limit_cycles(element, AMPLITUDES, lambda w: 1.0 / (1j * w * (1j * w + 1.0)), OMEGA)
    # -1/N = -(pi/4)(sqrt(A^2 - d^2) + i d); L = -(1 + i/w)/(1 + w^2)
    omega = 2 * np.pi * cycle.frequency_Hz
    assert 1.0 / (omega * (1.0 + omega**2)) == pytest.approx(np.pi * width / 4.0, rel=1e-7)
    assert np.sqrt(cycle.amplitude**2 - width**2) == pytest.approx(4.0 / np.pi / (1.0 + omega**2), rel=1e-7)


def test_saturation_below_the_critical_gain_has_none_and_above_it_has_one():
    def saturation(amplitude):
        if amplitude <= 1.0:
            return 1.0 + 0j
        return complex(2.0 / np.pi * (np.arcsin(1.0 / amplitude) + np.sqrt(1.0 - amplitude**-2) / amplitude))

    assert limit_cycles(saturation, AMPLITUDES, lambda w: 5.0 * third_order(w), OMEGA) == []
    (cycle,) = limit_cycles(saturation, AMPLITUDES, lambda w: 12.0 * third_order(w), OMEGA)
    assert saturation(cycle.amplitude).real == pytest.approx(0.5, rel=1e-8)


TANH = {"shaping": "tanh", "coefficients": (180.0, 0.0036, -0.11, 18.0)}
AFFINE = {"shaping": "affine", "coefficients": (0.63, -1.2)}
TABLE = {"shaping": "table", "table_V": (-20.0, 15.0, 60.0, 110.0, 150.0), "table_um": (-12.0, 8.0, 40.0, 66.0, 80.0)}
SHAPINGS = {"identity": {"shaping": "identity"}, "affine": AFFINE, "tanh": TANH, "table": TABLE}


def model(shaping, thresholds=(3.5, 7.0, 11.0, 20.0), weights=(0.1, 0.08, -0.05, 0.2), alpha=1.0):
    return PrandtlIshlinskii(
        model="pi", range_um=(0.0, 130.0), thresholds_um=thresholds, weights=weights, alpha=alpha, **SHAPINGS[shaping]
    )


@st.composite
def models(draw):
    """Identity or affine models whose inverse exists: partial sums positive, thresholds apart."""
    gaps = draw(st.lists(st.floats(0.2, 8.0), min_size=1, max_size=8))
    alpha = draw(st.floats(0.3, 3.0))
    sums = draw(st.lists(st.floats(0.2, 4.0), min_size=len(gaps), max_size=len(gaps)))
    weights = np.diff(np.array([alpha, *sums]))
    return model(draw(st.sampled_from(["identity", "affine"])), tuple(np.cumsum(gaps)), tuple(weights), alpha)


@given(models(), st.floats(0.05, 80.0), st.floats(-40.0, 90.0))
def test_quadrature_is_22_to_24_as_printed(m, amplitude, offset):
    """Identity and affine shaping, at any offset; an affine one divides by its slope."""
    operator = inverse_operator(m)
    moving = operator.thresholds < amplitude
    q, rho = operator.thresholds[moving] / amplitude, operator.weights[moving]
    theta = np.pi - np.arcsin(1.0 - 2.0 * q)
    a1 = 1.5 * np.pi + 0.5 * np.sin(2 * theta) + 2.0 * (2.0 * q - 1.0) * np.cos(theta) - theta
    b1 = -1.5 + 0.5 * np.cos(2 * theta) + 2.0 * (1.0 - 2.0 * q) * np.sin(theta)
    slope = m.coefficients[0] if m.shaping == "affine" else 1.0
    printed = (1.0 / m.alpha + rho @ a1 / np.pi + 1j * rho @ b1 / np.pi) / slope
    assert abs(harmonics(operator, amplitude, offset).gain - printed) < 1e-8 * abs(printed)


@pytest.mark.parametrize("shaping", SHAPINGS)
@pytest.mark.parametrize(("amplitude", "offset"), [(2.0, 40.0), (12.0, 30.0), (28.0, 42.0)])
def test_quadrature_is_what_the_loop_does(shaping, amplitude, offset):
    """Fourier coefficients of the voltage that the compiled feedforward gives for a sampled sine."""
    m, count = model(shaping), 40_000
    angle = 2 * np.pi * np.arange(count) / count
    # from the rest of (3) at zero to the offset, then three periods
    course = offset + amplitude * np.sin(np.tile(angle, 3))
    phi_zero = {"identity": 0.0, "affine": 1.2 / 0.63, "tanh": 0.0, "table": 1.0}[shaping]
    voltage = inverse(m, np.concatenate([[0.0], course]), start_V=phi_zero)[-count:]
    coefficient = np.fft.rfft(voltage) / count
    found = harmonics(inverse_operator(m), amplitude, offset)
    assert found.v0 == pytest.approx(coefficient[0].real, abs=1e-4)
    # v = a sin + b cos has the coefficient (b - i a)/2
    gain = (-2.0 * coefficient[1].imag + 2j * coefficient[1].real) / amplitude
    assert abs(found.gain - gain) < 1e-4 * abs(gain)


@pytest.mark.parametrize("shaping", SHAPINGS)
def test_quadrature_of_the_actuator_is_what_the_model_does(shaping):
    m, count, amplitude, offset = model(shaping), 40_000, 40.0, 60.0
    angle = 2 * np.pi * np.arange(3 * count) / count
    moved = predict(m, offset + amplitude * np.sin(angle))[-count:]
    coefficient = np.fft.rfft(moved) / count
    found = harmonics(actuator_operator(m), amplitude, offset)
    assert found.v0 == pytest.approx(coefficient[0].real, abs=1e-4)
    assert found.gain == pytest.approx((-2 * coefficient[1].imag + 2j * coefficient[1].real) / amplitude, rel=1e-4)


def test_the_sweep_meets_every_threshold():
    thresholds = inverse_operator(model("tanh")).thresholds
    amplitude = amplitudes_up_to(50.0, thresholds, 30)
    assert (np.diff(amplitude) > 0).all()
    assert all(np.abs(amplitude - r).min() < 1e-12 for r in thresholds)
    swept = sweep(model("tanh"), 60.0, amplitude)
    assert swept.gain_V_per_um[3] == harmonics(inverse_operator(model("tanh")), amplitude[3], 60.0).gain
    assert np.ptp(swept.v0_V) > 0.5  # a curved shaping moves the mean, by volts


def verdict(m, low, high):
    return judge(m, (low, high), gain_map(m, (low, high), 31, 30))


@pytest.mark.parametrize("shaping", SHAPINGS)
def test_a_good_model_has_no_singularity(shaping):
    found = verdict(model(shaping), 5.0, 75.0)
    assert found.problems == ()
    assert found.jump < 1e-9
    assert 0 < found.gain_range_V_per_um[0] < found.gain_range_V_per_um[1]


def test_beyond_the_end_of_tanh_there_is_no_inverse():
    high = attainable_um(model("tanh"))[1]
    found = verdict(model("tanh"), 5.0, high + 5.0)
    assert any("go beyond what the shaping can reach" in text for text in found.problems)
    assert any("no inverse for a sine of" in text for text in found.problems)


def test_attainable_range_is_that_of_a_long_course():
    m = model("tanh")
    volts = np.concatenate([np.linspace(0, -5000, 500), np.linspace(-5000, 5000, 1000), np.linspace(5000, -5000, 1000)])
    moved = predict(m, volts)[500:]
    assert (moved.min(), moved.max()) == pytest.approx(attainable_um(m), abs=1e-6)
    assert attainable_um(model("affine")) == (-np.inf, np.inf)


def test_bad_input_is_refused():
    operator = inverse_operator(model("affine"))
    for amplitude in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="must be positive and finite"):
            harmonics(operator, amplitude)
