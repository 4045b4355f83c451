"""Some of the faults of the campaign `faults`, of each kind one: all detected, undone, and nothing left behind.

The times that the campaign judges on a machine of its own are not judged here.
"""

import math
from dataclasses import replace

import pytest

from campaigns.fault_cells import PATIENT_WATCHDOG_MS, patient_can_cell
from campaigns.faults import campaign, cases

TRIED = (
    "10 % of all frames dropped",
    "sensor frames dropped, all",
    "command frames dropped, all",
    "value frozen, counter running",
    "bus-off of the controller",
    "gauge says NaN",
    "worker killed",
)


@pytest.mark.live  # the campaign itself tries again what a stall has spoilt
@pytest.mark.thorough  # each fault on the driver alone: tests/drivers/canbus; the daemon's way to rest: test_steps.py
def test_faults_of_a_bus(tmp_path):
    chosen = [replace(case, within_ms=math.inf) for case in cases("canbus") if case.fault in TRIED]
    assert len(chosen) == len(TRIED)
    outcomes = list(campaign(tmp_path, patient_can_cell(), chosen, PATIENT_WATCHDOG_MS))
    assert len(outcomes) == len(chosen) + 1
    assert [(outcome.name, outcome.wrong) for outcome in outcomes if outcome.wrong] == []
