"""What a recording says that the cycle needs: state, parameters, rows, as the records that it runs on now."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.recordings.file_header import PARAMETERS
from micromanip.recordings.file_header import SAMPLES as SAMPLES_FILE
from micromanip.rt.laws.coordinate_transform import MAX_FRAME
from micromanip.rt.laws.estimator import MAX_STATES
from micromanip.rt.laws.excitation import MAX_LINES
from micromanip.rt.laws.feedforward import MAX_CREEP
from micromanip.rt.laws.hysteresis import MAX_PLAYS, MAX_TABLE
from micromanip.rt.laws.network import MAX_NEURONS
from micromanip.rt.laws.reference import MAX_SINES, SAMPLES
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE, MAX_AXES, MAX_OUTPUTS, MAX_SIGNALS
from micromanip.rt.telemetry import ROW

_MOST = {
    "axes": MAX_AXES,
    "plays": MAX_PLAYS,
    "creeps": MAX_CREEP,
    "neurons": MAX_NEURONS,
    "points": MAX_TABLE,
    "states": MAX_STATES,
    "slow": MAX_STATES,
    "tooth": MAX_STATES - 1,
    "sines": MAX_SINES,
    "lines": MAX_LINES,
    "column": MAX_AXES - 1,
    "sources": MAX_FRAME,
    "derived": MAX_AXES,
}
"""The most that a counter in the parameters may be: compiled code looks at no bounds."""
_PLACES = {
    **dict.fromkeys(("strain", "stage", "deviation", "true_strain", "true_stage"), MAX_SIGNALS),
    **dict.fromkeys(("path_error", "uncompensated", "signal", "source", "first"), MAX_SIGNALS),
    **dict.fromkeys(("voltage", "amplifier_enable", "amplifier_reset", "feed_hold", "heartbeat"), MAX_OUTPUTS),
}


class Recorded:
    """A recording with what a cycle needs beside its row.

    `states`, each (1,), are those at the ends of cycles, by cycle; `parameters` the sets by version, each (1,);
    `samples` (n, MAX_AXES) what the source ``file`` played.
    """

    def __init__(self, telemetry: Telemetry) -> None:
        """Raises CheckFailed where the recording lacks what no cycle can be run without, or has other records."""
        file = telemetry.file
        telemetry.require_whole(PARAMETERS, SAMPLES_FILE)
        found = [*([] if telemetry.state is None else [telemetry.state]), *telemetry.states]
        if not found:
            telemetry.require_whole("state")
            raise CheckFailed(f"{file}: nothing can be replayed, the loop's state is not in it")
        self.telemetry = telemetry
        states = [self._as(each, CELL_STATE, "state") for each in found]
        self.states = {int(state["cycle"][0]): state for state in states}
        self.parameters: dict[int, NDArray[Any]] = {}
        for one in telemetry.parameters:
            taken = self._as(one, CELL_PARAMETERS, "parameters")
            _require_sound(telemetry, taken)
            self.parameters[int(taken["version"][0])] = taken
        plays = any((each["axis"]["reference"]["kind"] == SAMPLES).any() for each in self.parameters.values())
        if plays and telemetry.samples is None:
            raise CheckFailed(
                f"{file}: nothing can be replayed: an axis follows a file, and what that holds is not in the recording"
            )
        self.samples = np.zeros((1, MAX_AXES)) if telemetry.samples is None else _table(telemetry)

    def rows(self) -> Iterator[NDArray[Any]]:
        """Rows (n,) of ROW, in parts, from the first on."""
        for part in self.telemetry.rows():
            rows = self._as(part, ROW, "rows")
            if (rows["periods"] < 1).any():
                at = int(np.argmax(rows["periods"] < 1))
                raise CheckFailed(f"{self.telemetry.file}: damaged: row of cycle {rows['cycle'][at]} took no period")
            yield rows

    def _as(self, records: NDArray[Any], dtype: np.dtype[Any], what: str) -> NDArray[Any]:
        """A copy of `records` as `dtype`, which has the alignment that compiled code asks for."""
        if records.dtype != dtype:
            raise CheckFailed(
                f"{self.telemetry.file}: another version of micromanip recorded it, with other {what}: replay it with "
                "that version"
            )
        found = np.zeros(records.shape, dtype)
        found[...] = records
        return found


def _table(telemetry: Telemetry) -> NDArray[np.float64]:
    samples = np.array(telemetry.samples, dtype=float)
    if samples.ndim != 2 or samples.shape[1] != MAX_AXES or not len(samples):
        raise CheckFailed(f"{telemetry.file}: damaged: what the axes followed is a table of {samples.shape}")
    return samples


def _require_sound(telemetry: Telemetry, parameters: NDArray[Any]) -> None:
    for path, name, values in _integers(parameters, ""):
        most, places = _MOST.get(name), _PLACES.get(name)
        bad = most is not None and ((values < 0) | (values > most)).any()
        if bad or (places is not None and ((values < -1) | (values >= places)).any()):
            raise CheckFailed(f"{telemetry.file}: damaged: its parameters have {path} = {values.ravel().tolist()}")


def _integers(records: NDArray[Any], path: str) -> Iterator[tuple[str, str, NDArray[Any]]]:
    for name in records.dtype.names or ():
        values = records[name]
        if values.dtype.names:
            yield from _integers(values, f"{path}{name}.")
        elif values.dtype.kind == "i":
            yield f"{path}{name}", name, values
