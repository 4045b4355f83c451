"""The fit finds a model that predicts: known models with noise, and real recordings where they are there."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from micromanip.design.data import load_record
from micromanip.design.identify.fitting import Request, fit_record
from micromanip.design.identify.hysteresis import fit, structure_of
from micromanip.recordings import Wanted
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii
from tests.design.actuators import predict


def test_the_model_is_the_same_but_for_its_offset():
    t = 0.005 * np.arange(1200)
    v = 50.0 + 30.0 * np.sin(2 * np.pi * 0.9 * t) * (1.0 + 0.2 * np.sin(2.0 * t))
    y = 0.8 * v + 5.0 * np.sin(2 * np.pi * 0.9 * t - 0.6)
    plain = fit(structure_of("pi-tanh", v, 0.005, 5), v, y, (-1e4, 1e4), 50, starts=3)
    other = fit(structure_of("pi-tanh", v, 0.005, 5), v, y + 400.0, (-1e4, 1e4), 50, starts=3)
    assert other.model.weights == pytest.approx(plain.model.weights, rel=1e-9)
    np.testing.assert_allclose(other.predict(v), plain.predict(v) + 400.0, rtol=0, atol=1e-6)


DATA = Path(__file__).parents[3].parent / "shared" / "data" / "yan9a_piezo"
STEP_S, NOISE_UM = 2e-3, 0.05
WHOLE = (-1e4, 1e4)
BURN_IN = 500
RISING = tuple(float(r) for r in np.arange(1, 9) * 2.0)
TANH = {"shaping": "tanh", "coefficients": (60.0, 0.02, -1.3, 55.0)}
TRUE = {
    "pi-affine": {
        "shaping": "affine",
        "coefficients": (0.6, 5.0),
        "weights": (0.15, 0.12, 0.1, 0.08, 0.07, 0.06, 0.05, 0.04),
    },
    "pi-tanh": TANH | {"weights": tuple(0.15 * np.exp(-0.1 * np.array(RISING)))},
    "rate": TANH | {"weights": (0.1,) * 8, "rate_ms": 5.0},
    "pi-free": {
        "shaping": "table",
        "table_V": (10.0, 30.0, 50.0, 70.0, 90.0, 110.0),
        "table_um": (5.0, 16.0, 24.0, 36.0, 52.0, 61.0),
        "weights": (0.04, 0.08, 0.14, 0.2, 0.14, 0.08, 0.04, 0.02),
    },
    "pi-affine+creep": {
        "shaping": "affine",
        "coefficients": (0.6, 5.0),
        "weights": (0.1,) * 8,
        "creep_s": (0.1, 1.0),
        "creep_gains": (0.06, 0.05),
    },
}


def model_of(kind):
    weights = tuple(float(weight) for weight in TRUE[kind]["weights"])
    return PrandtlIshlinskii(model="pi", thresholds_um=RISING, range_um=WHOLE, **TRUE[kind] | {"weights": weights})


def voltage(seed, samples=4000):
    """Five tones that fill 10 .. 110 V."""
    t, rng = np.arange(samples) * STEP_S, np.random.default_rng(seed)
    tones = zip((0.3, 1.0, 2.3, 5.1, 9.7), (20.0, 13.0, 10.0, 8.0, 5.0), strict=True)
    wave = sum(size * np.sin(2 * np.pi * hertz * t + rng.uniform(0, 2 * np.pi)) for hertz, size in tones)
    return 10.0 + 100.0 * (wave - wave.min()) / np.ptp(wave)


def data(kind, seed=1):
    v = voltage(seed)
    clean = predict(model_of(kind), v, STEP_S)
    return v, clean + NOISE_UM * np.random.default_rng(100 + seed).standard_normal(len(v))


@pytest.mark.parametrize("kind", TRUE)
def test_a_known_model_is_predicted_to_the_noise(kind):
    """Outputs are compared, never parameters: slope and position of a tanh are hardly identifiable."""
    v, y = data(kind)
    name, _, creep = kind.partition("+")
    structure = structure_of(name, v, STEP_S, 8, bool(creep), smoothness=1e-4)
    fitted = fit(structure, v, y, WHOLE, BURN_IN, starts=4)
    # affine: its true weights are not quite an exponential; free: weights make up for thresholds a little beside
    most = {"pi-affine": 1.25, "pi-free": 2.2}.get(kind, 1.1)
    assert fitted.rms_um <= most * NOISE_UM
    other, clean = voltage(2), predict(model_of(kind), voltage(2), STEP_S)
    error = (fitted.predict(other) - clean)[BURN_IN:]
    assert np.sqrt(np.mean(error**2)) <= most * NOISE_UM
    assert fitted.model.model == "pi"
    from_zero = replace(fitted, x=np.append(fitted.x[:-1], -fitted.x[structure.shaping.offset]))
    np.testing.assert_allclose(predict(fitted.model, other, STEP_S), from_zero.predict(other), rtol=0, atol=1e-8)
    assert fitted.rms_percent == pytest.approx(100 * fitted.rms_um / np.ptp(y[BURN_IN:]))
    assert 0 < fitted.rms_std_um < 0.1 * fitted.rms_um


def test_the_offset_is_refitted_on_held_out_data():
    v, y = data("pi-affine")
    fitted = fit(structure_of("pi-affine", v, STEP_S, 8), v, y, WHOLE, BURN_IN, starts=1)
    other_v, other_y = data("pi-affine", 2)
    rms, largest = fitted.held_out(other_v, other_y, BURN_IN)
    assert fitted.held_out(other_v, other_y + 7.0, BURN_IN) == pytest.approx((rms, largest))
    error = (fitted.predict(other_v) - other_y)[BURN_IN:]
    assert rms == pytest.approx(100 * error.std() / np.ptp(other_y[BURN_IN:]))


@pytest.fixture(scope="module")
def real():
    """Two recordings of a real piezo manipulator."""
    if not DATA.is_dir():
        pytest.skip(f"the real recordings are not here: {DATA.name} is not beside the project")
    return [load_record(DATA / name, Wanted(("u_V", "y_um"))) for name in ("model_1hz.csv", "test_amplitudes.csv")]


@pytest.mark.long
@pytest.mark.parametrize(("kind", "fitted_percent", "held_out_percent"), [("pi-tanh", 0.87, 1.35), ("best", 0.62, 1.2)])
def test_real_recordings(real, kind, fitted_percent, held_out_percent):
    result = fit_record(*real, Request(kind, burn_in_s=1.0))
    assert result.rms_percent <= fitted_percent
    assert result.validation["rms_percent"] <= held_out_percent
    assert result.rms_std_percent < 0.1 * result.rms_percent
    tried = {each.name for each in result.tried}
    assert ({"pi-affine", "pi-tanh", "rate", "pi-free", "pi-tanh+creep", "network"} <= tried) == (kind == "best")
    if kind == "best":
        percent = {each.name: each.fitted_percent for each in result.tried}
        assert percent["network"] <= 1.1 * percent["pi-tanh"]
