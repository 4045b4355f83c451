"""A sine that a healthy stage would not bear is left out, said why, and costs no other sine or axis anything."""

import numpy as np
import pytest

from campaigns.simulated_cells import of_axes
from micromanip.cli.evaluate import _repeated
from micromanip.design import repeated
from micromanip.design.evaluation import evaluate_fast, fast_table
from micromanip.design.repeated import LEARNED
from micromanip.design.stage_swing import StageSwing
from micromanip.errors import CheckFailed
from micromanip.rt.telemetry import ROW

X216 = "the experiment was ended by a fault: X-216 axis x: limit cycle"


@pytest.fixture(scope="module")
def configuration():
    return of_axes("simulated.yaml", ["x", "y"]).configuration


def swings(x, y):
    hertz = np.array([10.0, 200.0])
    both = zip("xy", (x, y), strict=True)
    return {name: StageSwing(hertz, np.full(2, gain, complex), 0.0, (-300.0, 300.0)) for name, gain in both}


@pytest.fixture
def played(monkeypatch):
    """What is asked of the cell: the sines, and on which axes."""
    asked = []

    def sine(configuration, experiment, names, ways, loops, share, frequency_hz, amplitude_um, repetitions):
        asked.append((frequency_hz, *names))
        if frequency_hz == 150.0:
            raise CheckFailed(X216)
        row = {"axis": "", "frequency_hz": frequency_hz, "config": LEARNED, "true_std_error_um": share}
        return [(share, row | {"axis": name}) for name in names]

    monkeypatch.setattr(repeated, "_sine", sine)
    monkeypatch.setattr(repeated, "quiet_loops", lambda *_: {})
    monkeypatch.setattr(repeated, "measured_ways", lambda *_: {})
    monkeypatch.setattr(repeated, "_with_share", lambda configuration, *_: configuration)
    monkeypatch.setattr(repeated, "SINES", ((50.0, 10.0), (100.0, 20.0), (150.0, 10.0)))
    return asked


def test_an_axis_that_would_swing_is_left_alone_and_the_other_learns(configuration, played, monkeypatch):
    monkeypatch.setattr(repeated, "stage_swings", lambda *_: swings(x=20.0, y=5.0))
    rows = {(row["axis"], row["frequency_hz"]): row for row in repeated.repeated(configuration, None)}
    assert set(played) == {(50.0, "x", "y"), (100.0, "y"), (150.0, "x", "y")}
    assert rows["y", 100.0]["true_std_error_um"] == min(repeated.SHARES)
    refused = rows["x", 100.0]
    assert refused["true_std_error_um"] is None
    assert refused["asked_true_std_error_um"] == 0.020
    assert _repeated(refused) == (
        "E, axis x, 100 Hz, 20 um: not played, the stage would swing by up to 400 um about 0 um, and its sensor sees "
        "-300 to 300 um"
    )


def test_where_no_axis_bears_it_nothing_is_played_and_a_fault_ends_its_own_sine_only(
    configuration, played, monkeypatch
):
    monkeypatch.setattr(repeated, "stage_swings", lambda *_: swings(x=20.0, y=20.0))
    rows = repeated.repeated(configuration, None)
    assert {each[0] for each in played} == {50.0, 150.0}
    assert [row["axis"] for row in rows] == ["x"] * 3 + ["y"] * 3
    assert [row["refused"] for row in rows if row["frequency_hz"] == 150.0] == [X216] * 2


def test_a_fast_sine_that_ends_in_a_fault_is_a_row_without_figures(configuration):
    def experiment(variant, seconds, samples=None, every=1):
        if variant.reference.sines[0].frequency_Hz == 100.0:
            raise CheckFailed(X216)
        return np.zeros(round(seconds * variant.loop.rate_hz), ROW)

    steps = []
    runs = evaluate_fast(configuration, experiment, tuned=True, progress=lambda: steps.append(None))
    rows = fast_table(runs, configuration)
    assert len(steps) == 6
    assert len(rows) == 12
    for row in rows:
        faulted = row["frequency_hz"] == 100.0
        assert row["refused"] == (X216 if faulted else None)
        assert (row["true_std_error_um"] is None) is faulted
    assert len({frozenset(row) for row in rows}) == 1, "the same keys in each"
