"""Digital lines of the simulated cell: the amplifier's switch and watchdog, feed-hold, and no change without them."""

import numpy as np
import pytest

from .simulated_bench import Bench, quiet


def bench(**options):
    lines = {"retract_s": 0.05, **options.pop("lines", {})}
    return Bench(quiet(lines=lines, **options))


def volts(cell):
    return float(cell.c["s"][0]["amplifier_V"])


def test_an_enabled_amplifier_is_the_same_bit_for_bit():
    plain, wired = Bench({"axes": ["x", "y"]}), Bench({"axes": ["x", "y"], "lines": {}})
    for k in range(3000):
        plain.exchange(0.02 * k, 0.01 * k)
        # it is enabled from the first voltage on, and both start at 0 V
        wired.exchange(0.02 * k, 0.01 * k, 1.0, 0.0, 0.0)
        if k > 0:
            assert (wired.signals[: len(plain.signals)] == plain.signals).all()
    assert volts(plain) > 50.0


def test_a_disabled_amplifier_bleeds_with_its_time_constant():
    cell = bench()
    cell.hold(500, 60.0, 1.0, 0.0, 0.0)
    before = volts(cell)
    assert before == pytest.approx(60.0, abs=0.01)
    cell.exchange(60.0, 0.0, 0.0, 0.0)  # still enabled in this period: outputs act one sample late
    assert volts(cell) == pytest.approx(before, abs=0.01)
    cell.hold(200, 60.0, 0.0, 0.0, 0.0)
    assert volts(cell) == pytest.approx(before * np.exp(-1.0), rel=1e-6)
    cell.hold(2000, 60.0, 0.5, 0.0, 0.0)  # neither 0 nor 1 is not enabled either
    assert volts(cell) == pytest.approx(before * np.exp(-11.0), rel=1e-6)
    cell.hold(100, 60.0, 1.0, 0.0, 0.0)
    assert volts(cell) == pytest.approx(60.0, abs=0.01)


def test_feed_hold_retracts_the_tool():
    cell = bench(force={"start_s": 0.0, "static_N": 80.0, "tooth_N": 0.0, "noise_N": 0.0})
    cell.hold(2000, 0.0, 1.0, 0.0, 0.0)
    assert cell.c["s"][0]["force_N"] == pytest.approx(80.0, rel=1e-3)
    seen = []
    for _ in range(600):
        cell.exchange(0.0, 1.0, 1.0, 0.0)
        seen.append(cell.line("retracted"))
    assert seen.index(1.0) == 500  # the first of them only tells the PLC
    assert set(seen[500:]) == {1.0}
    assert cell.c["s"][0]["force_N"] == 0.0
    cell.exchange(0.0, 1.0, 0.0, 0.0)
    cell.exchange(0.0, 1.0, 0.0, 0.0)
    assert cell.line("retracted") == 0.0
    assert cell.c["s"][0]["force_N"] > 70.0


def test_watchdog_of_the_amplifier():
    """5 ms: a heartbeat that changes keeps it on, one that stands trips it until enable is taken away."""
    cell = bench(lines={"heartbeat_ms": 5.0})
    cell.hold(200, 60.0, 0.0, 0.0, 0.0)
    assert cell.line("amplifier_ok_x") == 1.0  # disabled, it does not watch
    for k in range(500):
        cell.exchange(60.0, 1.0, 0.0, float(k // 25 % 2))
    assert (cell.line("amplifier_ok_x"), volts(cell)) == (1.0, pytest.approx(60.0, abs=0.01))
    seen = []
    for _ in range(300):
        cell.exchange(60.0, 1.0, 0.0, 1.0)
        seen.append(cell.line("amplifier_ok_x"))
    last_change = 24  # cycles before: the heartbeat became 1 in the 25th last
    assert seen.index(0.0) == 50 - last_change
    assert volts(cell) < 20.0
    for k in range(100):
        cell.exchange(60.0, 1.0, 0.0, float(k % 2))  # too late
    assert cell.line("amplifier_ok_x") == 0.0
    cell.exchange(60.0, 0.0, 0.0, 0.0)
    for k in range(200):
        cell.exchange(60.0, 1.0, 0.0, float(k % 2))
    assert (cell.line("amplifier_ok_x"), volts(cell)) == (1.0, pytest.approx(60.0, abs=0.01))


def test_safe_switches_the_amplifier_off():
    cell = bench()
    cell.hold(500, 60.0, 1.0, 0.0, 0.0)
    assert cell.call("safe") == 0
    assert (cell.c["lines"]["amplifier_enable"], cell.c["s"][0]["latched_V"]) == (0, 0.0)
