"""What counts as a swing of the inner loop: what neither the tooth nor the set-point asks for."""

import numpy as np
import pytest
from scipy import signal

from micromanip.rt.states import FALLBACK, OSCILLATION
from micromanip.rt.watch import watch_inner
from micromanip.settings.compile.limits import fill_axis_limits
from micromanip.settings.schema.faults import AxisFaults, Oscillation
from micromanip.settings.schema.reference import Hold

from .bench_cell import BenchCell, Y, parameters

RATE_HZ = 10_000
BAND_HZ = (300.0, 1500.0)
T_S = np.arange(3000) / RATE_HZ


def watched(tooth_Hz=None, rate_Hz=RATE_HZ):
    record = parameters()
    limits = AxisFaults(oscillation=Oscillation(band_Hz=BAND_HZ, limit_um=1.0, time_ms=20.0))
    fill_axis_limits(record[0]["axis"][Y], limits, Hold(source="hold", offset_um=0.0), RATE_HZ, rate_Hz, 1, tooth_Hz)
    record[0]["axis"][Y]["watch"]["band_um"] = 1.0
    return BenchCell(record)


def energies(cell, error_um, setpoint_um):
    """Energy in the band after each sample; the watch starts at the first set-point."""
    axis, a, w = cell.p["axis"][Y], cell.s["axis"][Y], cell.s["watch"][Y]
    a["setpoint_um"], a["error_fresh"] = setpoint_um[0], 1
    watch_inner(axis, a, w, False)
    found = np.zeros(len(error_um))
    for k, (error, setpoint) in enumerate(zip(error_um, setpoint_um, strict=True)):
        a["strain_error_um"], a["setpoint_um"] = error, setpoint
        cell.noticed = watch_inner(axis, a, w, True)
        found[k] = w["band_energy"]
    return found


def raised(cell):
    return [code for code in (FALLBACK, OSCILLATION) if cell.noticed & (1 << code)]


def sine(frequency_Hz, amplitude):
    return amplitude * np.sin(2.0 * np.pi * frequency_Hz * T_S)


def band_pass(w0, q):
    return [w0 / q, 0.0], [1.0, w0 / q, w0**2]


def notch(w0, q):
    return [1.0, 0.0, w0**2], [1.0, w0 / q, w0**2]


def filtered(kind, middle_Hz, q, x):
    """By scipy, from the filter in s, its middle where it is meant to be."""
    warped = 2.0 * RATE_HZ * np.tan(np.pi * middle_Hz / RATE_HZ)
    return signal.lfilter(*signal.bilinear(*kind(warped, q), RATE_HZ), x)


@pytest.mark.many_cycles
@pytest.mark.parametrize("tooth_Hz", [None, 200.0, 533.0])
def test_energy_is_that_of_scipys_filters(tooth_Hz):
    rng = np.random.default_rng(3)
    error_um, setpoint_um = rng.normal(0.0, 2.0, (2, 1000))
    cell = watched(tooth_Hz)
    found = energies(cell, error_um, setpoint_um)
    middle_Hz = np.sqrt(BAND_HZ[0] * BAND_HZ[1])
    bands = [
        filtered(band_pass, middle_Hz, middle_Hz / (BAND_HZ[1] - BAND_HZ[0]), x)
        for x in (error_um, setpoint_um - setpoint_um[0])
    ]
    if tooth_Hz is not None:
        bands = [filtered(notch, tooth_Hz, 4.0, x) for x in bands]
    step = float(cell.p["axis"][Y]["watch"]["band_step"])
    expected = signal.lfilter([step], [1.0, step - 1.0], bands[0] ** 2 - bands[1] ** 2)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.many_cycles
@pytest.mark.parametrize("tooth_Hz", [200.0, 533.0])
def test_the_error_in_cancelling_a_tooth_is_no_swing(tooth_Hz):
    """3.5 um at its frequency, as on a soft flexure in the cut; without knowing of the tooth it is one."""
    error_um, setpoint_um = sine(tooth_Hz, 3.5), 66.0 + sine(tooth_Hz, 1.0)
    known, unknown = watched(tooth_Hz), watched()
    energies(known, error_um, setpoint_um)
    energies(unknown, error_um, setpoint_um)
    assert raised(known) == []
    assert raised(unknown) == [FALLBACK, OSCILLATION]


@pytest.mark.many_cycles
@pytest.mark.parametrize("frequency_Hz", [350.0, 760.0, 1234.0])
def test_a_swing_beside_the_tooth_is_noticed(frequency_Hz):
    """2 um of it, in a heavy cut that asks for 8 um at 200 Hz."""
    cell = watched(200.0)
    energies(cell, sine(frequency_Hz, 2.0) + sine(200.0, 3.5), 66.0 + sine(200.0, 8.0))
    assert raised(cell) == [FALLBACK, OSCILLATION]


@pytest.mark.many_cycles
def test_what_the_set_point_asks_for_is_no_swing():
    cell = watched()
    energies(cell, sine(600.0, 2.5), 66.0 + sine(600.0, 3.0))
    assert raised(cell) == []


@pytest.mark.many_cycles
def test_a_swing_that_the_outer_loop_answers_is_noticed():
    """Inner loops driven into their limit cycle had errors 1.35 to 1.5 times the set-point's motion."""
    cell = watched(200.0)
    energies(cell, sine(600.0, 14.0), 66.0 + sine(600.0, 10.5))
    assert raised(cell) == [FALLBACK, OSCILLATION]
