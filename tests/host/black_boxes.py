"""The black boxes that a controller in real processes leaves: found, explained, whole."""

import subprocess

import numpy as np
import pytest

from campaigns.running_controller import MICROMANIP, PATIENCE_S, until
from micromanip.host.trips.store import TripRecord, trips


def folder(cell):
    return cell.folder / "micromanip" / "trips"


def box_of(cell, *, complete=True, place=None):
    """The one box that there is, as soon as it is."""

    def found():
        files = trips(place or folder(cell))
        assert len(files) <= 1
        box = TripRecord.load(files[0]) if files else None
        return box if box is not None and (box.meta["complete"] or not complete) else None

    return until(found, lambda: f"a box; {cell.last_words()}")


def explained(cell, *arguments):
    command = [str(MICROMANIP), "trip", "show", "--trips", str(folder(cell)), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=PATIENCE_S).stdout


def assert_whole(box, before_ms, after_ms):
    """Every cycle of that time is in it, once; those that were missed are told."""
    rows = box.rows
    assert (np.diff(rows["cycle"]) == rows["periods"][1:]).all()
    period_ms = box.meta["period_ns"] * 1e-6
    ms = (rows["cycle"] - box.trip["cycle"]) * period_ms
    late = rows["periods"].max() * period_ms
    assert ms[0] == pytest.approx(-before_ms, abs=late + 0.2)
    assert ms[-1] == pytest.approx(after_ms, abs=late + 0.2)
