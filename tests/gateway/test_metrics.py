"""Metrics as Prometheus reads them: complete, in base units, clean by promtool; the dashboard finds what it asks."""

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from micromanip.gateway.metrics import Metrics
from micromanip.rt.mailbox import TRIPS, bin_of
from tests.cli.played import FAULT

from .rings import Played, rows, status


@pytest.fixture
def text(tmp_path):
    played = Played(tmp_path)
    played.play(rows(np.arange(1000)))
    played.read()
    for value in (50, 90, 1500, 700_000):
        played.status["lateness"][bin_of(value)] += 10
    played.status["words"][TRIPS] = 4
    played.cell.status = status("FAULT", [FAULT])
    return Metrics(played.cell, lambda: 3, lambda: 1).text().decode()


def samples(text):
    return {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_figures_are_in_base_units(text):
    found = samples(text)
    assert found["micromanip_up",] == 1
    assert found["micromanip_state", "FAULT"] == 1
    assert found["micromanip_state", "TRACKING"] == 0
    assert found["micromanip_cycles_total",] == 50_000
    assert found["micromanip_faults_total",] == 4
    assert found["micromanip_fault_latched", "STRAIN_INVALID", "X-201"] == 1
    assert found["micromanip_axis_position_meters", "x"] == pytest.approx(51.25e-6)
    assert found["micromanip_axis_error_rms_meters", "minute", "y"] == pytest.approx(0.5e-6)
    assert found["micromanip_axis_headroom_volts", "x"] == 50.0
    assert found["micromanip_axis_tooth_hertz", "x"] == 199.5
    assert found["micromanip_axis_joint_hertz", "1", "x"] == 8.25
    assert ("micromanip_axis_joint_hertz", "2", "x") not in found, "it is not followed"
    assert found["micromanip_signal_age_seconds", "99.9", "strain_x"] == pytest.approx(1.9e-3)
    assert found["micromanip_link_up", "can"] == 1
    assert found["micromanip_gateway_rows_seen_total",] == 1000


def test_the_histogram_is_the_loop_s(text):
    found = samples(text)
    buckets = {
        float(name[1]): value for name, value in found.items() if name[0] == "micromanip_lateness_seconds_bucket"
    }
    assert [buckets[bound] for bound in (1e-7, 1e-6, 2e-6, 5e-4, 1e-3, float("inf"))] == [20, 20, 30, 30, 40, 40]
    assert found["micromanip_lateness_seconds_count",] == 40
    assert found["micromanip_lateness_seconds_sum",] == pytest.approx(10 * (50 + 90 + 1500 + 700_000) * 1e-9, rel=0.03)
