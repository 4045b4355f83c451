"""Black boxes made by hand: two axes that track at 10 kHz, and trip at cycle 30 000."""

import numpy as np

from micromanip.host.trips.store import FORMAT, TripRecord
from micromanip.rt.faults import EVENT
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE
from micromanip.rt.states import RAMPING, STAGE, STRAIN, STRAIN_INVALID, TRACKING
from micromanip.rt.telemetry import ROW

TRIP = 30_000
BEFORE, AFTER = 20_000, 5_000


def tracking_rows():
    """Axis 0 in mode stage with 0.5 um of error, axis 1 in mode strain without; strain and stage fresh each cycle."""
    rows = np.zeros(BEFORE + AFTER + 1, ROW)
    rows["cycle"] = np.arange(TRIP - BEFORE, TRIP + AFTER + 1)
    rows["time_ns"], rows["periods"], rows["version"] = rows["cycle"] * 100_000, 1, 3
    rows["state"] = np.where(rows["cycle"] < TRIP, TRACKING, RAMPING)
    rows["fault"] = np.where(rows["cycle"] < TRIP, 0, STRAIN_INVALID)
    axis = rows["axis"]
    axis["fresh"] = 3
    axis["voltage_V"] = 60.0
    axis["strain_um"] = axis["setpoint_um"] = 65.0 + 1e-3 * np.arange(len(rows))[:, None]
    axis["reference_um"][:, 0], axis["stage_um"][:, 0], axis["path_error_um"] = 100.0, 99.5, np.nan
    return rows


def event(cycle, code, axis, value, limit):
    """One entry of the loop's list."""
    return np.array([(cycle, code, axis, value, limit, 0, TRACKING)], EVENT)


def box(rows=None, events=(), **trip):
    """A complete box of `rows` and `events`; `trip` replaces fields of the trip."""
    parameters = np.zeros(1, CELL_PARAMETERS)
    parameters["version"] = 3
    parameters["axis"]["mode"][0, :2] = STAGE, STRAIN
    parameters["axis"]["limiter"]["low_V"], parameters["axis"]["limiter"]["high_V"] = -20.0, 150.0
    parameters["axis"]["stage"][0, 1] = parameters["axis"]["deviation"][0, 1] = -1
    parameters["axis"]["deviation"][0, 0] = -1
    found = {
        "code": "X-201",
        "number": STRAIN_INVALID,
        "axis": "x",
        "value": 3.0,
        "limit": None,
        "seen": "X-201 axis x: no usable strain-gauge sample for 3 cycles",
        "message": "X-201 axis x: no usable strain-gauge sample for 3 cycles. Likely: a cable. Check it.",
        "cycle": TRIP,
    }
    meta = {
        "format": FORMAT,
        "trip": found | trip,
        "complete": True,
        "utc": "2026-03-14T10:15:02.250+00:00",
        "utc_ns": 1_773_483_302_250_000_000,
        "monotonic_ns": TRIP * 100_000,
        "period_ns": 100_000,
        "axes": ["x", "y"],
        "configuration": "schema_version: 2\n",
        "sha256": "0" * 64,
        "path": "cell.yaml",
    }
    raised = np.concatenate([np.zeros(0, EVENT), *events])
    return TripRecord(meta, tracking_rows() if rows is None else rows, parameters, np.zeros(1, CELL_STATE), raised)
