"""Scheduled faults of the simulated cell: each kind, its time, slow channels, and options that make no sense."""

import numpy as np
import pytest

from .simulated_bench import Bench, quiet

AT, CYCLES = 10, 5  # the 10th exchange is the first at 1 ms
NOISY = {"axes": ["x"]}


def fault(channel, kind, value=0.0, **times):
    return {"channel": channel, "kind": kind, "value": value, "at_s": 1e-3, "for_s": CYCLES * 1e-4, **times}


def played(options, channel, cycles=30, periods=1):
    """Samples (cycles,) of `channel` as the loop sees them, and those of the same cell without the faults."""
    rows = []
    for given in (options, {**options, "faults": []}):
        cell = Bench(given)
        where = cell.driver.inputs.index(channel)
        row = []
        for k in range(cycles):
            assert cell.exchange(0.02 * k, periods=periods) == 0
            row.append(cell.signals[where].copy())
        rows.append(np.array(row))
    return rows


def differing(a, b, field="value"):
    """1-based numbers of the exchanges in which `field` differs."""
    same = (a[field] == b[field]) | (np.isnan(a[field]) & np.isnan(b[field]) if a[field].dtype.kind == "f" else False)
    return (np.flatnonzero(~same) + 1).tolist()


DURING = list(range(AT, AT + CYCLES))


def test_value_replaces_the_reading_for_its_time():
    bad, good = played({**NOISY, "faults": [fault("strain_x", "value", 7.5)]}, "strain_x")
    assert differing(bad, good) == DURING
    assert (bad["value"][AT - 1 : AT - 1 + CYCLES] == 7.5).all()
    assert (bad["sequence"] == good["sequence"]).all()


def test_freeze_repeats_the_last_value_with_a_running_sequence():
    bad, good = played({**NOISY, "faults": [fault("strain_x", "freeze")]}, "strain_x")
    assert (bad["value"][AT - 1 : AT - 1 + CYCLES] == good["value"][AT - 2]).all()
    assert differing(bad, good) == [k for k in DURING if good["value"][k - 1] != good["value"][AT - 2]]
    assert len(differing(bad, good)) > 2
    assert (bad["sequence"] == good["sequence"]).all()


def test_nan_and_status():
    both = [fault("strain_x", "nan"), fault("stage_x", "status")]
    bad, good = played({**NOISY, "faults": both}, "strain_x")
    assert (np.flatnonzero(np.isnan(bad["value"])) + 1).tolist() == DURING
    bad, good = played({**NOISY, "faults": both}, "acceleration_x")
    assert differing(bad, good) == []
    still = quiet(plant={"stage_zero_um": 0.0}, faults=both)
    bad, good = played(still, "stage_x")
    assert differing(bad, good, "status") == DURING
    assert differing(bad, good) == []


def test_drop_lets_no_sample_come():
    bad, good = played({**NOISY, "faults": [fault("strain_x", "drop")]}, "strain_x")
    held = bad[AT - 2]
    assert (bad[AT - 1 : AT - 1 + CYCLES] == held).all()
    assert (bad["value"][AT - 1 + CYCLES :] == good["value"][AT - 1 + CYCLES :]).all()
    assert np.diff(bad["sequence"][AT - 2 + CYCLES :]).tolist() == [1] * (len(bad) - AT - CYCLES + 1)


def test_a_slow_channel_is_hit_at_its_own_rate():
    """The tracker comes every 10 cycles: its next sample is the one that is spoilt, once."""
    times = {"at_s": 0.0011, "for_s": 0.002}
    faults = [fault("deviation_x", "offset", 50.0, **times)]
    bad, good = played({**NOISY, "faults": faults}, "deviation_x", 60)
    assert differing(bad, good) == list(range(20, 40))
    assert (bad["value"] - good["value"])[19:39] == pytest.approx(50.0)
    spike = [fault("deviation_x", "spike", 50.0, at_s=0.0011, for_s=None)]
    bad, good = played({**NOISY, "faults": spike}, "deviation_x", 60)
    assert differing(bad, good) == list(range(20, 30))


def test_an_overrun_does_not_jump_over_a_fault():
    faults = [fault("strain_x", "value", 7.0, for_s=2e-4)]  # the 10th and 11th period
    bad, good = played({**NOISY, "faults": faults}, "strain_x", 6, periods=4)
    assert differing(bad, good) == [3]


def test_a_failed_exchange_returns_its_code_and_leaves_the_samples():
    cell = Bench(quiet(faults=[fault("exchange", "error", 17.0)]))
    codes, sequence = [], []
    for _ in range(20):
        codes.append(cell.exchange(1.0))
        sequence.append(int(cell.signal("strain")["sequence"]))
    assert [k + 1 for k, code in enumerate(codes) if code == 17] == DURING
    assert set(codes) == {0, 17}
    assert sequence[AT - 2] == sequence[AT - 2 + CYCLES]
    assert cell.c["periods"] == 20  # the plant has gone on all the time
