"""The simulated cell: timing, converters, sensors, mechanics, force, path; and its contract."""

import numpy as np
import pytest
from micromanip_drivers.simulated import mechanics
from micromanip_drivers.simulated.options import Plant
from scipy import signal

from .simulated_bench import NO_FORCE, PERIOD_NS, STILL, Bench, quiet

PERIOD_S = PERIOD_NS * 1e-9

# -- found, configured, opened -------------------------------------------------------------------------


def test_exchange_before_open_and_after_close_returns_a_code():
    bench = Bench(opened=False)
    assert bench.exchange() != 0
    assert (bench.signals["sequence"] == 0).all()
    assert bench.call("open") == 0
    assert bench.exchange() == 0
    assert (bench.signals["sequence"][0], bench.signals["time_ns"][0]) == (1, bench.now_ns)
    assert bench.call("close") == 0
    assert bench.exchange() != 0
    assert bench.signals["sequence"][0] == 1


def test_safe_discharges():
    bench = Bench(quiet())
    bench.record(200, "strain", volts=lambda k: 100.0)
    assert bench.c["s"][0]["amplifier_V"] == pytest.approx(100.0, abs=0.01)
    assert bench.call("safe") == 0
    assert bench.c["safe"] == 1
    assert bench.c["s"][0]["latched_V"] == 0.0
    bench.record(200, "strain", volts=lambda k: 0.0)
    assert bench.c["s"][0]["amplifier_V"] == pytest.approx(0.0, abs=0.01)


# -- determinism, overruns -----------------------------------------------------------------------------


def test_all_its_state_is_in_the_context():
    """A copy of the bytes goes on exactly as the original does."""
    one, other = Bench(), Bench()
    for k in range(50):
        one.exchange(k, 0.5 * k, 20.0)
    other.context[:] = one.context
    other.signals[:], other.now_ns = one.signals, one.now_ns
    for k in range(50):
        one.exchange(30.0, k, 20.0)
        other.exchange(30.0, k, 20.0)
    assert one.signals.tobytes() == other.signals.tobytes()


# -- amplifier and converters --------------------------------------------------------------------------


def test_a_voltage_acts_one_sample_late():
    bench = Bench(quiet())
    bench.exchange(0.0)
    bench.exchange(50.0)
    assert bench.c["s"][0]["amplifier_V"] == 0.0
    bench.exchange(50.0)
    assert bench.c["s"][0]["amplifier_V"] > 1.0


def test_amplifier_is_first_order_of_900_Hz():
    bench = Bench(quiet())
    bench.exchange(2.0)  # small: no slewing
    course = []
    for _ in range(10):
        bench.exchange(2.0)
        course.append(float(bench.c["s"][0]["amplifier_V"]))
    t = PERIOD_S * np.arange(1, 11)
    assert course == pytest.approx(bench.c["s"][0]["latched_V"] * (1 - np.exp(-2 * np.pi * 900.0 * t)), rel=1e-9)


@pytest.mark.parametrize("target", [150.0, -20.0])
def test_amplifier_slews_40_V_per_ms_inside_its_range(target):
    bench = Bench(quiet())
    course = [0.0]
    for _ in range(200):
        bench.exchange(10.0 * target)
        course.append(float(bench.c["s"][0]["amplifier_V"]))
    assert np.abs(np.diff(course)).max() <= 4.0 + 1e-9
    assert course[-1] == pytest.approx(target, abs=0.01)
    if target > 100.0:
        assert np.abs(np.diff(course)).max() == pytest.approx(4.0)


# -- mechanics -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step_s", [0.5e-4, 2.5e-3])
@pytest.mark.parametrize("second_mode", [None, {}])
def test_discretisation_is_exact_for_held_inputs(step_s, second_mode):
    plant = Plant(second_mode=second_mode)
    a, b = mechanics.discrete(plant, step_s)
    A, B = mechanics.continuous(plant)
    expected_a, expected_b, *_ = signal.cont2discrete((A, B, np.eye(len(A)), np.zeros((len(A), 2))), step_s)
    assert a == pytest.approx(expected_a, rel=1e-9, abs=1e-12)
    assert b == pytest.approx(expected_b, rel=1e-9, abs=1e-15)


# -- sensors ---------------------------------------------------------------------------------------------


def test_noise_figures():
    bench = Bench({"axes": ["x"], "force": NO_FORCE, "deviation": STILL})
    names = ("strain", "true_strain", "stage", "true_stage", "acceleration", "deviation")
    rows = bench.record(20_000, *names, volts=lambda k: 60.0)[4000:]
    strain = rows[:, 0] - rows[:, 1]
    t = PERIOD_S * np.arange(len(strain))
    hum = 2 * np.abs(np.mean(strain * np.exp(-2j * np.pi * 50.0 * t)))
    assert hum == pytest.approx(0.010, abs=0.002)
    quiet_strain = bench.c["s"][0]["x"][4]  # the gauge's own filter makes it lag what is true, at rest not at all
    assert np.isfinite(quiet_strain)
    assert np.sqrt(strain.var() - hum**2 / 2) == pytest.approx(0.055, rel=0.05)
    assert (rows[:, 2] - rows[:, 3]).std() == pytest.approx(0.012, rel=0.05)
    assert rows[8000:, 4].std() == pytest.approx(0.02, rel=0.3)
    assert np.unique(rows[:, 5]).std() == pytest.approx(0.5, rel=0.1)
    # white: hardly any correlation from sample to sample
    white = rows[:, 2] - rows[:, 3]
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.03


def test_capacitive_sensor_at_the_end_of_its_range():
    """At rest the stage is beyond it: the reading is the end, and it says so if there is a status for it."""
    bench = Bench(quiet())
    bench.exchange(0.0)
    assert bench.signal("true_stage")["value"] == pytest.approx(-329.9, abs=3.0)
    assert bench.signal("stage")["value"] == -300.0
    assert bench.signal("stage")["status"] != 0
    bench.record(3000, "stage", volts=lambda k: min(75.0, 0.05 * k))
    assert abs(bench.signal("stage")["value"]) < 300.0
    assert bench.signal("stage")["status"] == 0


def test_tracker_has_its_own_rate_and_latency():
    bench = Bench(quiet(deviation={}))
    seen = []
    for _ in range(100):
        before = int(bench.signal("deviation")["sequence"])
        bench.exchange(0.0)
        if bench.signal("deviation")["sequence"] > before:
            s = bench.signal("deviation")
            seen.append((bench.now_ns, int(s["time_ns"]), float(s["value"])))
    assert len(seen) == 10
    assert {now - taken for now, taken, _ in seen} == {1_000_000}
    # what it saw then is where the path was then: the path error is deviation minus stage
    fresh = Bench(quiet(deviation={}))
    path = {}
    for _ in range(100):
        fresh.exchange(0.0)
        path[fresh.now_ns] = fresh.signal("path_error")["value"] + fresh.signal("true_stage")["value"]
    for _, taken, value in seen[1:]:
        assert value == pytest.approx(path[taken], abs=1e-9)


# -- force, path, coupling, drift -----------------------------------------------------------------------


def test_machining_force():
    bench = Bench({"axes": ["x"], "force": {"start_s": 0.1}})
    force = []
    for _ in range(22_000):
        bench.exchange(60.0)
        force.append(float(bench.c["s"][0]["force_N"]))
    force = np.array(force)
    assert (force[:999] == 0.0).all()
    rising, late = force[1000:1600], force[2000:22_000]
    t = PERIOD_S * np.arange(len(late))
    assert late.mean() == pytest.approx(80.0, abs=2.0)
    assert 2 * np.abs(np.mean(late * np.exp(-2j * np.pi * 200.0 * t))) == pytest.approx(40.0, abs=1.0)
    assert np.sqrt(late.var() - 40.0**2 / 2) == pytest.approx(5.0, rel=0.25)
    smooth = np.convolve(rising, np.ones(50) / 50, "valid")  # over one tooth
    assert smooth[175] == pytest.approx(80.0 * (1 - np.exp(-1.0)), abs=12.0)


def moved(volts, options):
    """How far (um) each stage of three goes when x is driven to `volts`, at the end of 0.8 s."""
    bench = Bench({**quiet(), "axes": ["x", "y", "z"], **options})
    bench.hold(500, 0.0, 0.0, 0.0)
    still = [float(bench.signal("true_stage", axis)["value"]) for axis in "xyz"]
    for k in range(8000):
        bench.exchange(min(volts, 0.02 * k), 0.0, 0.0)
    return np.array([float(bench.signal("true_stage", axis)["value"]) for axis in "xyz"]) - still


def test_the_flexure_pushes_the_other_axes_by_their_share():
    """At rest by the share; x itself is pushed back by the product of both ways only."""
    went = moved(60.0, {"coupling": 0.0, "flexure_coupling": 0.03})
    alone = moved(60.0, {"coupling": 0.0})
    assert alone[1:] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert went[1] / went[0] == pytest.approx(0.02, rel=0.05), "y sees 2/3 of x, the axis after its next"
    assert went[2] / went[0] == pytest.approx(0.03, rel=0.05)
    assert went[0] / alone[0] == pytest.approx(1.0, abs=0.005)


# -- noise generator -------------------------------------------------------------------------------------
