"""Telemetry made up by the tests: rows, a ring that plays them, and a cell that the gateway sees."""

import numpy as np

from micromanip.gateway.cell import Cell, Source
from micromanip.host.shared_memory import CONTROL, RING, STATUS, columns
from micromanip.rt.mailbox import RING_HEAD
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import ROW
from tests.cli import played

AXES = ["x", "y"]
PERIOD_NS = 100_000
TOLD = {
    "axes": AXES,
    "drivers": ["cell"],
    "range_V": {"x": [-20.0, 150.0], "y": [-20.0, 150.0]},
    "period_ns": PERIOD_NS,
    "status_bytes": STATUS.itemsize,
    "row_bytes": ROW.itemsize,
    "control_bytes": CONTROL.itemsize,
    "columns": columns(),
}


def rows(cycles, **values):
    """Rows of these cycles; `values` by column, those of axis x as `x_strain_um`."""
    made = np.zeros(len(cycles), ROW)
    made["cycle"], made["time_ns"] = cycles, np.asarray(cycles) * PERIOD_NS
    made["periods"], made["state"] = 1, TRACKING
    for name, value in values.items():
        if name.startswith("x_"):
            made["axis"][name[2:]][:, 0] = value
        else:
            made[name] = value
    return made


class Played:
    """A ring and a status in ordinary memory, and the cell before it; `play` adds rows as the loop would."""

    def __init__(self, path):
        self.ring, self.status, self.control = (np.zeros(1, kind)[0] for kind in (RING, STATUS, CONTROL))
        self.cell = Cell(path)
        self.cell.source = Source(TOLD, self.status, self.ring, self.control, 1)

    def play(self, new):
        head = int(self.ring["words"][RING_HEAD])
        self.ring["rows"][np.arange(head, head + len(new)) % len(self.ring["rows"])] = new
        self.ring["words"][RING_HEAD] = head + len(new)

    def has_read(self):
        """Whether the cell has taken in all that was played."""
        return self.cell.source.reader.position == self.ring["words"][RING_HEAD]

    def read(self):
        """Let the cell take in all that was played, and tell it."""
        while (new := self.cell.source.read()) is not None:
            for listener in list(self.cell.listeners):
                listener(new)


SIGNAL = {"rate_hz": 9999.5, "stated_hz": 1e4, "age_p50_us": 0, "age_p99_9_us": 1900, "age_max_us": 2000}
SIGNAL |= {"lost": 3, "superseded": 4, "refused": 2, "samples": 7, "late": 1, "stale_cycles": 5}
LINK = {"link": "up", "outputs": "following", "links": 2, "starts": 1, "message": None}


def status(state="TRACKING", faults=()):
    """What a controller answers, whole."""
    more = {"signals": {"strain_x": SIGNAL}, "links": {"can": LINK}, "parameter_version": 2, "recording": None}
    more |= {"candidate": "none", "trips": [], "configuration": "cell.yaml", "configuration_sha256": "0" * 64}
    return played.status(state, faults) | more
