"""What a controller tells of its recording, and the rows of an HDF5 file, opened as anybody would."""

import h5py
import numpy as np

from micromanip.client import Client


def recorded_rows(file):
    """The rows of a recording; each cycle is there once, in order."""
    with h5py.File(file) as recording:
        rows = recording["rows"][:]
        assert recording["state"][0]["cycle"] < rows["cycle"][0]
        assert set(rows["version"]) <= set(recording["parameters"]["version"])
    assert (np.diff(rows["cycle"]) == rows["periods"][1:]).all()
    return rows


def recording_of(cell):
    """As `status` tells of it."""
    with Client(cell.socket) as client:
        return client.status()["recording"]
