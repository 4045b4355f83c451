"""What a recording says that the cycle needs: state, parameters, rows, as the records that it runs on now."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.recordings.filed import FILED_PARAMETERS
from micromanip.recordings.mcap_layout import PARAMETERS
from micromanip.recordings.mcap_layout import SAMPLES as SAMPLES_FILE
from micromanip.rt.laws.coordinate_transform import MAX_FRAME
from micromanip.rt.laws.estimator import MAX_STATES
from micromanip.rt.laws.excitation import MAX_LINES
from micromanip.rt.laws.feedforward import MAX_CREEP
from micromanip.rt.laws.hysteresis import MAX_PLAYS
from micromanip.rt.laws.network import MAX_NEURONS
from micromanip.rt.laws.reference import MAX_SINES, SAMPLES
from micromanip.rt.laws.shaping import MAX_TABLE
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE, MAX_AXES, MAX_OUTPUTS, MAX_SIGNALS
from micromanip.rt.states import AMPLIFIER_FAULT, DERATED, DRIVER_ERROR, LINK_LOST, OUTPUTS_TAKEN
from micromanip.rt.telemetry import (
    AMPLIFIER_OK,
    DEVIATION_CAME,
    DEVIATION_FRESH,
    DRIVER_FAILED,
    LINK_DOWN,
    OUTPUTS_ARE_TAKEN,
    ROW,
    STAGE_CAME,
    STAGE_FRESH,
    STRAIN_CAME,
    STRAIN_FRESH,
    TEMPERATURE_OK,
)

FRESH = STRAIN_FRESH | STAGE_FRESH | DEVIATION_FRESH
CAME = STRAIN_CAME | STAGE_CAME | DEVIATION_CAME
_CAME_OF_FRESH = STRAIN_CAME // STRAIN_FRESH
_LINK_FAULTS = {DRIVER_ERROR: DRIVER_FAILED, LINK_LOST: LINK_DOWN, OUTPUTS_TAKEN: OUTPUTS_ARE_TAKEN}
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
    `samples` (n, MAX_AXES) what the source ``file`` played; `unlike` names fields in which records differ from those
    of this version.
    """

    def __init__(self, telemetry: Telemetry) -> None:
        """Raises CheckFailed where the recording lacks what no cycle can be run without."""
        file = telemetry.file
        telemetry.require_whole(PARAMETERS, SAMPLES_FILE)
        found = [*([] if telemetry.state is None else [telemetry.state]), *telemetry.states]
        if not found:
            telemetry.require_whole("state")
            raise CheckFailed(f"{file}: nothing can be replayed, the loop's state is not in it")
        self.telemetry = telemetry
        self.unlike: list[str] = []
        states = [self._as(each, CELL_STATE, "state") for each in found]
        self.states = {int(state["cycle"][0]): state for state in states}
        self.parameters: dict[int, NDArray[Any]] = {}
        for one in telemetry.parameters:
            for filed in one:
                taken = self._as(filed[None], FILED_PARAMETERS, "parameters").view(CELL_PARAMETERS)
                _require_sound(telemetry, taken)
                self.parameters[int(taken["version"][0])] = taken
        plays = any((each["axis"]["reference"]["kind"] == SAMPLES).any() for each in self.parameters.values())
        if plays and telemetry.samples is None:
            raise CheckFailed(
                f"{file}: nothing can be replayed: an axis follows a file, and what that holds is not in the "
                "recording; it is in those that this version makes"
            )
        self.samples = np.zeros((1, MAX_AXES)) if telemetry.samples is None else _table(telemetry)
        self.is_complete = True

    @property
    def lacks(self) -> list[str]:
        """What rows of an older version do not say; known once they have been read."""
        if self.is_complete:
            return []
        return ["samples that came and were not usable", "lines of the amplifiers at rest", "links and outputs at rest"]

    def rows(self) -> Iterator[NDArray[Any]]:
        """Rows (n,) of ROW, in parts, from the first on; what those of an older version do not say is filled in."""
        for part in self.telemetry.rows():
            rows = self._as(part, ROW, "rows")
            fresh = rows["axis"]["fresh"]
            if self.is_complete and ((fresh & FRESH) & ~(fresh >> 3)).any():
                self.is_complete = False
            if not self.is_complete:
                _fill_in(rows)
            if (rows["periods"] < 1).any():
                at = int(np.argmax(rows["periods"] < 1))
                raise CheckFailed(f"{self.telemetry.file}: damaged: row of cycle {rows['cycle'][at]} took no period")
            yield rows

    def _as(self, records: NDArray[Any], dtype: np.dtype[Any], what: str) -> NDArray[Any]:
        """A copy of `records` as `dtype`; fields by their names, those that are not there are 0, places of none."""
        found = np.zeros(records.shape, dtype)
        if records.dtype == dtype:  # but for its alignment, which compiled code asks for
            found[...] = records
            return found
        _carry(records, found, what, self.unlike)
        return found


def _carry(old: NDArray[Any], new: NDArray[Any], path: str, unlike: list[str]) -> None:
    """Fields of `old` to those of `new` that are called so; `unlike` gets those that have no counterpart."""
    theirs, ours = set(old.dtype.names or ()), set(new.dtype.names or ())
    for name in ours - theirs:
        _unwire(new, name)
    for name in sorted(theirs ^ ours):
        if (note := f"{path}.{name}") not in unlike:
            unlike.append(note)
    for name in theirs & ours:
        if old.dtype[name].base.names and old[name].shape == new[name].shape:
            _carry(old[name], new[name], f"{path}.{name}", unlike)
        elif not old.dtype[name].base.names and not new.dtype[name].base.names:
            if old[name].shape == new[name].shape:
                new[name] = old[name]
            elif (note := f"{path}.{name}") not in unlike:
                unlike.append(note)


def _unwire(records: NDArray[Any], name: str) -> None:
    """No signal and no output stands in the field `name`, nor in what it has within: 0 would be the first of them."""
    inner = records.dtype[name].base.names or ()
    if name in _PLACES and not inner:
        records[name] = -1
    for each in inner:
        _unwire(records[name], each)


def _fill_in(rows: NDArray[Any]) -> None:
    """Take what came for what was usable, and lines and links for what the faults say of them."""
    axis = rows["axis"]
    axis["fresh"] |= (axis["fresh"] & FRESH) * _CAME_OF_FRESH
    axis["fresh"] |= np.where(axis["conditions"] & (1 << AMPLIFIER_FAULT), 0, AMPLIFIER_OK).astype("i4")
    axis["fresh"] |= np.where(axis["conditions"] & (1 << DERATED), 0, TEMPERATURE_OK).astype("i4")
    for fault, bit in _LINK_FAULTS.items():
        rows["lines"] |= np.where(rows["fault"] == fault, bit, 0).astype("i4")


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
