"""Runs of the simulated cell in virtual time, recorded as the recorder does."""

import numpy as np

from micromanip.host.recording.mcap_file import McapRecording
from micromanip.recordings import open_telemetry
from micromanip.virtual.cell import VirtualCell


def recording(file, prepared, rows, state=None, parameters=None, samples=None, kept=()):
    """`rows` recorded to `file`; `state` is before them, by default of a cell at rest; `kept` are those on the way."""
    configuration = prepared.configuration
    about = {"configuration": prepared.source.text, "sha256": prepared.source.hash}
    orders = {"file": str(file), "axes": list(configuration.axes), "period_ns": configuration.loop.period_ns}
    written = McapRecording(about | orders)
    if state is None:
        state = VirtualCell(prepared.parameters, prepared.wiring).state
    written.begin(state[0], samples)
    slots = prepared.parameters if parameters is None else parameters
    for first in range(0, len(rows), 4096):
        written.append(rows[first : first + 4096], np.asarray(slots))
    for one in kept:
        written.keep(one)
    written.close()
    return open_telemetry(file)
