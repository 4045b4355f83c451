"""Some of the faults of `make fault-campaign`, of each kind one: all detected, undone, and nothing left behind.

The times that the campaign judges on a machine of its own are not judged here.
"""

import math
from dataclasses import replace

import pytest

from tools.bus_faults.campaign import campaign
from tools.bus_faults.cases import CAN
from tools.bus_faults.cells import PATIENT_WATCHDOG_MS, patient_can_cell

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
@pytest.mark.xdist_group("loop")
def test_faults_of_a_bus(tmp_path):
    cases = tuple(replace(case, within_ms=math.inf) for case in CAN if case.name in TRIED)
    assert len(cases) == len(TRIED)
    outcomes = list(campaign(tmp_path, patient_can_cell(), cases, PATIENT_WATCHDOG_MS))
    assert len(outcomes) == len(cases) + 1
    assert [(outcome.name, outcome.wrong) for outcome in outcomes if outcome.wrong] == []
