"""Runs of the simulated cell in virtual time, recorded as the recorder does."""

import numpy as np

from campaigns.report import CONFIG
from micromanip.host.recording.mcap_file import McapRecording
from micromanip.recordings import open_telemetry
from micromanip.settings.check import prepared
from micromanip.virtual.cell import VirtualCell

SIMULATED = CONFIG / "simulated.yaml"
TRACKED_S = 4.0
"""From 3.4 s on; the tool comes into contact at 5 s."""


def recording(file, cell, rows, state=None, parameters=None, samples=None, kept=()):
    """`rows` recorded to `file`; `state` is before them, by default of a cell at rest; `kept` are those on the way."""
    configuration = cell.configuration
    about = {"configuration": cell.source.text, "sha256": cell.source.hash}
    orders = {"file": str(file), "axes": list(configuration.axes), "period_ns": configuration.loop.period_ns}
    written = McapRecording(about | orders)
    state = VirtualCell(cell.parameters, cell.wiring).state if state is None else state
    written.begin(state[0], samples)
    slots = cell.parameters if parameters is None else parameters
    for first in range(0, len(rows), 4096):
        written.append(rows[first : first + 4096], np.asarray(slots))
    for one in kept:
        written.keep(one)
    written.close()
    return open_telemetry(file)


def track(cell, parameters, stalls=(), window=None):
    """Rows (n,) of the cell from its start on, or of `window`, `TRACKED_S` of them behind its arming; same noise.

    `stalls` are moments (s, of the tracking) from which on the next cycle comes so many periods later.
    """
    virtual = VirtualCell(parameters.copy(), prepared(cell.source).wiring, cell.samples, list(cell.configuration.axes))
    rows, period_s, begin, periods = [virtual.arm()], int(parameters[0]["period_ns"]) * 1e-9, 0, 1
    for at_s, late in [*stalls, (TRACKED_S, 1)]:
        end = round(at_s / period_s)
        rows.append(virtual.run((end - begin) * period_s, periods=periods))
        begin, periods = end, late
    rows = np.concatenate(rows)
    return rows if window is None else rows[rows["cycle"] >= window.rows["cycle"][0]][: len(window.rows)]
