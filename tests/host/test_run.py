"""``micromanip run --json``: the document that other tools rely on."""

import math

import pytest

from campaigns.running_controller import Running
from tests.cells import QUICK, simulated

pytestmark = pytest.mark.realtime  # path errors of a real loop

DURATIONS = {"p50", "p99", "p99_9", "p99_99", "max"}


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    cell = Running(tmp_path_factory.mktemp("run"), simulated(*QUICK), "--duration", "5")
    try:
        assert cell.wait() == 0, cell.said
        return cell.report  # nothing but one JSON document on standard output, or this fails
    finally:
        assert cell.kill() == []


def test_one_document_with_everything_in_it(report):
    assert {"cycles", "overruns", "period_ns", "lateness_ns", "compute_ns"} <= report.keys()
    assert report["state"] == "OFF"
    assert report["faults"] == []
    assert report["period_ns"] == 100_000
    assert 35_000 <= report["cycles"] + report["overruns"] <= 35_000 + 200_000
    assert report["cycles"] > 10_000
    for key in ("lateness_ns", "compute_ns"):
        figures = report[key]
        assert figures.keys() == DURATIONS
        assert all(isinstance(value, int) for value in figures.values())
        assert 0 <= figures["p50"] <= figures["p99"] <= figures["p99_9"] <= figures["p99_99"] <= figures["max"]
    assert report["compute_ns"]["p50"] > 100  # nobody computes three axes in less


def test_path_error(report):
    assert report["path_error_um"].keys() == {"x", "y", "z"}
    for figures in report["path_error_um"].values():
        assert figures.keys() == {"uncompensated_rms", "rms", "max"}
        assert all(math.isfinite(value) for value in figures.values())
        assert 0.05 < figures["rms"] < figures["max"]


def test_path_error_is_small_where_the_machine_lets_the_loop_run(report):
    if report["overruns"] > 0.005 * report["cycles"]:
        pytest.skip(f"the machine stalled the loop: {report['overruns']} overruns in {report['cycles']} cycles")
    for figures in report["path_error_um"].values():
        assert figures["rms"] < figures["uncompensated_rms"] / 5
