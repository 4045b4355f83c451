"""What a controller tells of its recording, and the rows that are in its file."""

from pathlib import Path

import numpy as np

from micromanip.client import Client
from micromanip.recordings import open_telemetry


def recorded_rows(file, dropped=0):
    """The rows of a recording; each cycle is there once, in order, but for those that a busy recorder has `dropped`."""
    telemetry = open_telemetry(Path(file))
    rows = np.concatenate(list(telemetry.rows()))
    assert telemetry.state["cycle"][0] < rows["cycle"][0]
    assert set(rows["version"]) <= {int(each["version"][0]) for each in telemetry.parameters}
    missing = np.diff(rows["cycle"]) - rows["periods"][1:]
    assert 0 <= missing.min() <= missing.sum() <= dropped
    return rows


def recording_of(cell):
    """As `status` tells of it."""
    with Client(cell.socket) as client:
        return client.status()["recording"]
