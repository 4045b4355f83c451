"""The loop's own cycle on recorded rows: each row is turned back into the process image that it was written of.

For another tuning, the row is that which its voltages would have left (`difference`).

What a sample that was not usable read is known by its place only (`micromanip.rt.telemetry`): any number at that place
does the same to the cycle.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types

from micromanip.rt import telemetry as bits
from micromanip.rt.cycle import ALL_FOLLOW, FIRST_TAKEN, run_cycle
from micromanip.rt.jit import Compiler
from micromanip.rt.record import MAX_AXES, Record
from micromanip.rt.shadow import swap_cell
from micromanip.rt.signatures import OUTPUTS, PARAMETERS, ROWS, SAMPLES, SIGNALS, STATES, WORDS, array_of
from micromanip.rt.states import HOST_DEAD, TRACKING
from micromanip.rt.telemetry import ROW, write_row

from .difference import (
    DIFFERENCE_MODEL,
    DIFFERENCE_STATE,
    advance_difference,
    at_age,
    cycles_ago,
    give_setpoint,
    give_voltage,
)

NO_SWAP, SWAP_BEFORE, SWAP_AFTER = range(3)
"""Another set of parameters in the first row: none, from its cycle on, or behind its cycle, as a promotion does."""

NOTHING_DIFFERS = (
    np.zeros(MAX_AXES, DIFFERENCE_MODEL),
    np.zeros(MAX_AXES, DIFFERENCE_STATE),
    np.zeros((0, MAX_AXES)),
    np.zeros(1, ROW),
)
"""Models, their state, free displacements, and room for a row, where the tuning is the recorded one."""

_compiled = Compiler(__file__)
_ANY = (-math.inf, math.inf)


@_compiled
def _between(good: float, end: float, last: float) -> float:
    """A number between the last good sample and an end, another one than `last`."""
    way = end - good if math.isfinite(end) else math.copysign(2.0, end)
    return good + 0.5 * way if good + 0.5 * way != last else good + 0.25 * way


@_compiled
def _unusable(reading: int, repeated: bool, s: Record, range_um: Any) -> float:
    """Something that reads as the sample did."""
    last: float = s["reading"]
    good: float = s["value"]
    low: float = range_um[0]
    high: float = range_um[1]
    if reading == bits.INFINITE:
        return math.inf
    if reading == bits.MINUS_INFINITE:
        return -math.inf
    if repeated:
        return last
    if reading == bits.HIGH_END:
        return high if high != last else high + 1.0
    if reading == bits.LOW_END:
        return low if low != last else low - 1.0
    if reading == bits.SAME:
        return good
    if reading == bits.ABOVE:
        return _between(good, high, last)
    return _between(good, low, last) if reading == bits.BELOW else math.nan


@_compiled
def _leave_sample(
    place: int, s: Record, signals: Any, range_um: Any, told: Any, value: float, age_ns: int, now_ns: int
) -> None:
    """Leave a sensor's sample in the image as a driver does; `told`: came, fresh, repeated, and what it read."""
    if place < 0:
        return
    signal = signals[place]
    came, fresh, repeated, reading = told
    signal["sequence"] = s["sequence"] + came
    signal["status"] = 1 - fresh
    signal["time_ns"] = now_ns - (age_ns if fresh else 0)
    signal["value"] = value if fresh else _unusable(reading, repeated != 0, s, range_um)


@_compiled
def _leave_line(line: Record, s: Record, signals: Any, on: bool, now_ns: int) -> None:
    if line["signal"] >= 0:
        signal = signals[line["signal"]]
        signal["sequence"] = s["sequence"] + 1
        signal["value"], signal["time_ns"], signal["status"] = 1.0 if on else 0.0, now_ns, 0


@_compiled
def _leave_part(p: Record, s: Record, signals: Any, lines: int, now_ns: int) -> None:
    """The machine's word for the part: the same number until the row says that another one has begun."""
    place = p["part"]["signal"]
    _leave_line(p["part"], s["part_line"], signals, lines & bits.PART_RUNS != 0, now_ns)
    if place >= 0 and lines & bits.PART_RUNS != 0:
        turned = _bit(lines, bits.PART_TURN) != s["parts"] % 2
        signals[place]["value"] = float(s["part"] + (1 if turned else 0))


@_compiled
def _leave_tool(p: Record, s: Record, signals: Any, lines: int, now_ns: int) -> None:
    """The machine's word for the tool: its number stands in the row."""
    place = p["tool"]["signal"]
    _leave_line(p["tool"], s["tool_line"], signals, False, now_ns)
    if place >= 0:
        signals[place]["value"] = float(lines >> bits.TOOL)


@_compiled
def _leave_value(place: int, signals: Any, value: float) -> None:
    if place >= 0:
        signals[place]["value"] = value


@_compiled
def _bit(word: int, mask: int) -> int:
    return 1 if word & mask != 0 else 0


@_compiled
def _told(word: int, came: int, fresh: int, repeated: int, reading: int) -> Any:
    """What a row says of a sample, as `_leave_sample` takes it."""
    return _bit(word, came), _bit(word, fresh), _bit(word, repeated), word >> reading & 7


@_compiled
def _leave_axis(p: Record, a: Record, row: Record, signals: Any, outputs: Any, now_ns: int) -> None:
    word = row["fresh"]
    strain = _told(word, bits.STRAIN_CAME, bits.STRAIN_FRESH, bits.STRAIN_REPEATED, bits.STRAIN_READING)
    stage = _told(word, bits.STAGE_CAME, bits.STAGE_FRESH, bits.STAGE_REPEATED, bits.STAGE_READING)
    deviation = _bit(word, bits.DEVIATION_CAME), _bit(word, bits.DEVIATION_FRESH), 0, 0
    _leave_sample(
        p["strain"], a["strain"], signals, p["strain_range_um"], strain, row["strain_um"], row["strain_age_ns"], now_ns
    )
    _leave_sample(
        p["stage"], a["stage"], signals, p["stage_range_um"], stage, row["stage_um"], row["stage_age_ns"], now_ns
    )
    _leave_sample(
        p["deviation"], a["deviation"], signals, _ANY, deviation, row["deviation_um"], row["deviation_age_ns"], now_ns
    )
    outputs[p["voltage"]] = a["voltage_V"] - (_bit(word, bits.DEVICE_BELOW) - _bit(word, bits.DEVICE_ABOVE))
    _leave_line(p["amplifier_ok"], a["amplifier_ok"], signals, word & bits.AMPLIFIER_OK != 0, now_ns)
    _leave_line(p["temperature_ok"], a["temperature_ok"], signals, word & bits.TEMPERATURE_OK != 0, now_ns)
    _leave_value(p["true_strain"], signals, row["true_strain_um"])
    _leave_value(p["true_stage"], signals, row["true_stage_um"])
    _leave_value(p["path_error"], signals, row["path_error_um"])
    _leave_value(p["uncompensated"], signals, row["uncompensated_um"])


@_compiled
def _exchange_code(lines: int) -> int:
    """What the exchange with the drivers returned, but for which of them it was."""
    if lines & bits.DRIVER_FAILED != 0:
        return 1
    if lines & bits.LINK_DOWN != 0:
        return -1
    if lines & bits.OUTPUTS_ARE_TAKEN != 0:
        return FIRST_TAKEN
    return ALL_FOLLOW if lines & bits.OUTPUTS_ARE_AWAY != 0 else 0


@_compiled
def _leave_cell(p: Record, s: Record, row: Record, signals: Any, outputs: Any, now_ns: int) -> None:
    lines = row["lines"]
    _leave_line(p["enable"], s["enable"], signals, lines & bits.ENABLED != 0, now_ns)
    _leave_line(p["interlock"], s["interlock"], signals, lines & bits.INTERLOCKED != 0, now_ns)
    _leave_line(p["retracted"], s["retracted"], signals, lines & bits.RETRACTED != 0, now_ns)
    _leave_part(p, s, signals, lines, now_ns)
    _leave_tool(p, s, signals, lines, now_ns)
    for i in range(p["axes"]):
        _leave_axis(p["axis"][i], s["axis"][i], row["axis"][i], signals, outputs, now_ns)


@_compiled
def _differ(p: Record, models: Any, differences: Any, row: Record, periods: int) -> None:
    """Go `periods` cycles on, and make of the recorded `row` what the sensors would have said."""
    period_ns = p["period_ns"]
    for i in range(p["axes"]):
        for passed in range(periods):
            if passed > 0:
                give_setpoint(models[i], differences[i])
            advance_difference(models[i], differences[i])
    for i in range(p["axes"]):
        axis, own = row["axis"][i], differences[i]
        ago = cycles_ago(axis["stage_age_ns"], period_ns)
        seen, stage = 0.0, 0.0
        for j in range(p["axes"]):
            d, share = differences[j], models[i]["coupling"][j]
            if share != 0.0:
                seen += share * at_age(d["stages"], d, ago)
                stage += share * at_age(d["stages"], d, 0)
        axis["strain_um"] += at_age(own["strains"], own, cycles_ago(axis["strain_age_ns"], period_ns))
        axis["stage_um"] += seen
        axis["true_strain_um"] += at_age(own["strains"], own, 0)
        axis["true_stage_um"] += stage
        axis["path_error_um"] -= stage


@_compiled.entry(
    types.int64(
        PARAMETERS,
        STATES,
        SIGNALS,
        OUTPUTS,
        SAMPLES,
        ROWS,
        WORDS,
        ROWS,
        types.int64,
        types.int64,
        array_of(DIFFERENCE_MODEL),
        array_of(DIFFERENCE_STATE),
        types.float64[:, ::1],
        ROWS,
    ),
)
def replay_rows(
    parameters: Any,
    state: Any,
    signals: Any,
    outputs: Any,
    samples: Any,
    recorded: Any,
    commands: Any,
    replayed: Any,
    swap: int,
    tracks_from: int,
    models: Any,
    differences: Any,
    free_um: Any,
    scratch: Any,
) -> int:
    """Run the cycles of the rows `recorded` (n,) from `state` (1,) on; their own rows go to `replayed` (n,).
    Returns how many those are: from row `tracks_from` on, the first that leaves TRACKING is the last.

    `parameters` (2,) are the set in force and, with `swap`, the one that comes in the first row; `commands` (n,) are
    those that were carried out. The cycle is that of the loop, ``rt/cycle.py``; coordinates of a tracker
    are in the rows as the axes' deviations already. Where `models` (MAX_AXES,) are present, what the voltages do
    otherwise is added to the rows, its state in `differences` (MAX_AXES,); `free_um` (n, MAX_AXES) are the free
    displacements under the recorded ones, `scratch` is one row.
    """
    p, s = parameters[0], state[0]
    parameters[0]["frame"]["sources"] = parameters[1]["frame"]["sources"] = 0  # what is derived is in the rows
    differs = models[0]["present"] != 0
    if swap == SWAP_BEFORE:
        swap_cell(p, parameters[1], s)
        p = parameters[1]
    for k in range(len(recorded)):
        row = recorded[k]
        now_ns, periods = row["time_ns"], row["periods"]
        dead = row["fault"] == HOST_DEAD
        if differs:
            scratch[0] = row
            row = scratch[0]
            _differ(p, models, differences, row, periods)
        _leave_cell(p, s, row, signals, outputs, now_ns)
        code, silent_ns = _exchange_code(row["lines"]), p["heartbeat_ns"] + 1 if dead else 0
        run_cycle(p, s, signals, outputs, samples, code, commands[k], now_ns, periods - 1, silent_ns)
        if swap == SWAP_AFTER and k == 0:
            swap_cell(p, parameters[1], s)
            p = parameters[1]
        if differs:
            for i in range(p["axes"]):
                give_voltage(models[i], differences[i], s["axis"][i]["voltage_V"], free_um[k, i])
        write_row(p, s, signals, replayed[k], now_ns, row["lateness_ns"], row["compute_ns"], periods)
        if k >= tracks_from and s["state"] != TRACKING:
            return k + 1
    return len(recorded)
