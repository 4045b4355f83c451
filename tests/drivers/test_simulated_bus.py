"""The simulated cell behind a bus: its rates, its latencies, and that nothing else changes."""

import numpy as np
import pytest

from .simulated_bench import PERIOD_NS, Bench, quiet

BUS = {"input_rate_Hz": 2000.0, "input_latency_us": 300.0, "output_rate_Hz": 2000.0, "output_latency_us": 200.0}
AT_ONCE = {"input_rate_Hz": 10_000.0, "output_rate_Hz": 10_000.0}


def arrivals(bench, channel, cycles):
    """Cycles (from 1) in which a fresh sample of `channel` came, and how old it was, in cycles."""
    found, before = [], 0
    for k in range(1, cycles + 1):
        bench.exchange()
        signal = bench.signals[bench.driver.inputs.index(channel)]
        if signal["sequence"] != before:
            assert signal["sequence"] == before + 1
            found.append((k, (bench.now_ns - signal["time_ns"]) // PERIOD_NS))
            before = int(signal["sequence"])
    return found


@pytest.mark.parametrize("channel", ["strain_x", "stage_x", "acceleration_x", "enable", "amplifier_ok_x"])
def test_samples_come_at_their_rate_and_late(channel):
    assert arrivals(Bench(quiet(bus=BUS, lines={})), channel, 24) == [(8, 3), (13, 3), (18, 3), (23, 3)]


def test_a_sample_shows_the_moment_in_which_it_was_taken():
    bench, truth = Bench(quiet(bus=BUS)), []
    for k in range(200):
        bench.exchange()
        bench.c["s"][0]["latched_V"] = 0.05 * k
        truth.append(float(bench.signal("true_strain")["value"]))
    taken = int(bench.signal("strain")["time_ns"]) // PERIOD_NS - 1
    # the gauge's own 64 us of lag aside
    assert bench.signal("strain")["value"] == pytest.approx(truth[taken], abs=0.05)
    assert abs(truth[taken] - truth[-1]) > 0.1


def test_outputs_are_taken_at_their_rate_latest_value_first_and_held():
    bench = Bench(quiet(bus=BUS))
    seen = []
    for k in range(1, 25):
        bench.exchange(float(k))
        seen.append(round(float(bench.c["s"][0]["latched_V"])))
    # ticks in cycles 5, 10, ...; in force two later
    assert seen == [0] * 6 + [5] * 5 + [10] * 5 + [15] * 5 + [20] * 3


def test_a_bus_as_fast_as_the_loop_changes_nothing():
    volts = lambda k: 40.0 + 30.0 * np.sin(0.01 * k)  # noqa: E731
    plain, bus = ({"axes": ["x"], "bus": each} for each in (None, AT_ONCE))
    channels = ("strain", "stage", "deviation", "path_error")
    assert (Bench(plain).record(3000, *channels, volts=volts) == Bench(bus).record(3000, *channels, volts=volts)).all()


def test_missed_cycles_send_what_was_written_before_them():
    bench = Bench(quiet(bus=BUS))
    bench.hold(4, 10.0)
    bench.exchange(20.0, periods=6)  # cycles 5 to 10: the tick of 5 found 10 V, that of 10 finds 20 V
    assert float(bench.c["s"][0]["latched_V"]) == pytest.approx(10.0, abs=0.01)
    bench.exchange(20.0, periods=2)
    assert float(bench.c["s"][0]["latched_V"]) == pytest.approx(20.0, abs=0.01)
