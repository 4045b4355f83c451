"""Kalman filter of one axis: predicts in every cycle, updates only on a fresh sample, at its own age.

Model per cycle ``x+ = A x + B u``, ``y = C x``: identified dynamics, actuation delay, random-walk
input disturbance and tooth-passing oscillator; u is the actuator set-point that was really given
(after its limits), relative to the working point, y the capacitive sensor, both in um.

``filtered`` is the estimate at the cycle of the last fresh sample, ``x`` its prediction to now. A sample of age `age`
cycles corrects the estimate of its own cycle: ``filtered`` is predicted to that cycle with the stored set-points,
corrected there, and predicted to now again. The gain belongs to the cycles m since the sample before
(``control/gain_schedule.py``): the stationary one where m is the sensor's interval, whose error dynamics
``(I - L C) A^m`` are checked to be stable with the configuration. With that gain for every m the estimate would diverge
if most cycles are missed.

No sample moves the estimate by an implausible amount: an innovation larger than sensor noise and process explain
(``innovation_um``) is limited to that. While innovations exceed the limit, it opens threefold per sample, and then
closes slowly again. So a real event is followed a few samples later, and a reading that was late, held or false for a
moment leaves no disturbance behind. The third of identical readings counts for no more than the sensor's noise: the
value is held somewhere, or nothing moves. After a gap the states of motion take the whole innovation, because the
motion during the gap is unknown; the disturbances do not.

If the tooth's frequency is followed (``frequency_lock.py``), its oscillator turns by more, or less, than in the model.
Once it is dropped, the filter has the gains of the filter without it (``plain``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.jit import compiled
from micromanip.rt.record import Field, Record, record
from micromanip.rt.sums import LANES, ROWS_AT_ONCE, advance_model, correct, weighted

from .frequency_lock import FOLLOWS, TOOTH, TOOTH_STATE, follow_tooth, forget_tooth, start_tooth, turn_on

MAX_STATES = 2 * ROWS_AT_ONCE
"""A model behind a slow bus has a state for each cycle of its delay."""
GAPS = 64
"""Cycles between two samples up to which each number of them has a gain of its own; that of the last serves more."""
INPUT_HISTORY = 256
"""Cycles that estimator and axis remember (a power of two): a sample may be that many cycles old."""

MODEL: tuple[Field, ...] = (
    ("states", "i8"),
    ("slow", "i8"),
    ("innovation_um", "f8"),
    ("repeated_um", "f8"),
    ("gap_cycles", "i8"),
    *TOOTH,
    ("b", "f8", (MAX_STATES,)),
    ("c", "f8", (MAX_STATES,)),
)
"""Parameters: the model and the filter's assumptions; ``slow``: the first of the states that are disturbances;
``innovation_um``: how large an innovation may be at once, ``repeated_um`` of a reading that is the same for the third
time; ``gap_cycles``: samples further apart than that leave the estimate uncertain."""
MATRICES: tuple[Field, ...] = (
    ("a_blocks", "f8", (MAX_STATES // ROWS_AT_ONCE, MAX_STATES, ROWS_AT_ONCE)),
    ("gains", "f8", (GAPS, MAX_STATES)),
    ("plain", "f8", (GAPS, MAX_STATES)),
    ("steady_u", "f8", (MAX_STATES,)),
    ("steady_y", "f8", (MAX_STATES,)),
)
"""What is large, and mostly padding or for rare gaps, behind what each cycle reads. Gains are by the cycles since the
sample before, less one."""
ESTIMATOR_STATE = record(
    ("filtered", "f8", (MAX_STATES,)),
    ("x", "f8", (MAX_STATES,)),
    ("scratch", "f8", (MAX_STATES,)),
    ("filtered_cycle", "i8"),
    ("cycle", "i8"),
    ("innovation_um", "f8"),
    ("opened_um", "f8"),
    ("reading_um", "f8"),
    ("repeated", "i8"),
    ("running", "i8"),
    *TOOTH_STATE,
    ("history", "f8", (INPUT_HISTORY,)),
)

_MASK = INPUT_HISTORY - 1
_OPENS, _CLOSES = 2.0, 0.9
"""How much more than usual may come after an innovation, in terms of it; what is left of that a sample later."""
_REPEATED = 2


def in_blocks(A: NDArray[np.float64]) -> NDArray[np.float64]:
    """The columns of `A` (n, n) as ``a_blocks`` has them: (blocks, MAX_STATES, ROWS_AT_ONCE)."""
    columns = np.zeros((MAX_STATES, MAX_STATES))
    columns[: len(A), : len(A)] = A.T
    return columns.reshape(MAX_STATES, -1, ROWS_AT_ONCE).swapaxes(0, 1)


@compiled
def predict(p: Record, x: Any, scratch: Any, u: float) -> None:
    """One cycle of the model: ``x <- A x + B u``."""
    advance_model(p["a_blocks"], p["b"], u, x, scratch, p["states"])


@compiled
def output(p: Record, x: Any) -> float:
    """``C x``: the sensor reading (um) that the estimate `x` expects."""
    return weighted(p["c"], x, filled(p))


@compiled
def filled(p: Record) -> int:
    """States with those that fill the last lanes of a vector: these are 0, and so is what belongs to them."""
    return (p["states"] + LANES - 1) & -LANES


@compiled
def _advance(p: Record, s: Record, x: Any, first: int, last: int) -> None:
    for cycle in range(first, last):
        predict(p, x, s["scratch"], s["history"][cycle & _MASK])
        if p["tooth"] > 0:
            turn_on(p, s, x)


@compiled.rare
def start_estimator(p: Record, s: Record, cycle: int, u: float, y: float) -> None:
    """State at rest that agrees with set-point `u` held and sensor reading `y`."""
    for i in range(MAX_STATES):
        s["filtered"][i] = p["steady_u"][i] * u + p["steady_y"][i] * y
        s["x"][i] = s["filtered"][i]
    for k in range(INPUT_HISTORY):
        s["history"][k] = u
    s["filtered_cycle"] = cycle
    s["cycle"] = cycle
    s["innovation_um"] = s["opened_um"] = 0.0
    s["reading_um"] = y
    s["repeated"] = 0
    s["running"] = 1
    start_tooth(s)


@compiled
def change_model(old: Record, new: Record, s: Record) -> None:
    """Keep the estimate, whatever the gains, where one model is the other plus disturbances; else it starts anew."""
    n, same = min(old["states"], new["states"]), True
    for i in range(n):
        same = same and old["b"][i] == new["b"][i] and old["c"][i] == new["c"][i]
        block, row = i // ROWS_AT_ONCE, i % ROWS_AT_ONCE
        for j in range(n):
            same = same and old["a_blocks"][block, j, row] == new["a_blocks"][block, j, row]
    if not same:
        s["running"] = 0
    for i in range(n, MAX_STATES):
        s["x"][i] = s["filtered"][i] = 0.0
    if old["tooth"] != new["tooth"] or old["tooth_range"] != new["tooth_range"]:
        start_tooth(s)


@compiled
def remember(s: Record, u: float) -> None:
    """Store the set-point `u` of the present cycle."""
    s["history"][s["cycle"] & _MASK] = u


@compiled
def predict_to(p: Record, s: Record, cycle: int) -> None:
    """Carry ``x`` to `cycle`; cycles that an overrun skipped held the set-point before them."""
    held = s["history"][s["cycle"] & _MASK]
    for skipped in range(s["cycle"] + 1, min(cycle, s["cycle"] + INPUT_HISTORY)):
        s["history"][skipped & _MASK] = held
    _advance(p, s, s["x"], max(s["cycle"], cycle - INPUT_HISTORY + 1), cycle)
    s["cycle"] = cycle


@compiled
def follow_stage(
    p: Record, s: Record, sensor: Record, given_um: float, cycle: int, cycles_per_ns: float, usable: bool
) -> None:
    """Predict to `cycle`; correct with a fresh sample of the `sensor` at its own age, where that is `usable`.

    It starts with a fresh sample only, at rest at the set-point `given_um`: earlier samples may be old.
    """
    if s["running"] != 0:
        predict_to(p, s, cycle)
        if sensor["fresh"] and usable:
            update(p, s, cycle - int(sensor["age_ns"] * cycles_per_ns + 0.5), sensor["value"])
    elif sensor["fresh"]:
        start_estimator(p, s, cycle, given_um, sensor["value"])


@compiled
def believed(p: Record, s: Record, innovation: float) -> float:
    """The limited innovation (um); the limit opens or closes for the next one."""
    limit_um = p["innovation_um"] + s["opened_um"] if s["repeated"] < _REPEATED else p["repeated_um"]
    applied = max(-limit_um, min(limit_um, innovation))
    s["opened_um"] = max(_OPENS * abs(applied), _CLOSES * s["opened_um"])
    return applied


@compiled
def update(p: Record, s: Record, sample_cycle: int, y: float) -> bool:
    """Apply the sample `y` taken at `sample_cycle`; False where it is too old to be of use.

    ``x`` must have been carried to the present cycle. A sample not younger than the one before is
    refused (out of order); after a gap longer than the memory the filter starts anew.
    """
    now = s["cycle"]
    if sample_cycle <= s["filtered_cycle"] or sample_cycle > now or now - sample_cycle >= INPUT_HISTORY:
        return False
    if now - s["filtered_cycle"] >= INPUT_HISTORY:
        start_estimator(p, s, now, s["history"][(now - 1) & _MASK], y)
        return True
    n = p["states"]
    passed = sample_cycle - s["filtered_cycle"]
    tooth = p["tooth"] if s["given_up"] == FOLLOWS else 0
    gains = p["gains"] if p["tooth"] == tooth else p["plain"]
    gain = gains[min(passed, GAPS) - 1]
    s["repeated"] = s["repeated"] + 1 if y == s["reading_um"] else 0
    s["reading_um"] = y
    expected = s["x"]
    if sample_cycle != now:
        expected = s["filtered"]
        _advance(p, s, expected, s["filtered_cycle"], sample_cycle)
    innovation = y - output(p, expected)
    applied = believed(p, s, innovation)
    if tooth > 0:
        o1, o2 = expected[tooth], expected[tooth + 1]
        follow_tooth(p, s, o1, o2, gain[tooth] * applied, gain[tooth + 1] * applied, applied)
    correct(expected, gain, applied, s["filtered"], s["x"], n)
    if passed > p["gap_cycles"]:
        for i in range(p["slow"]):
            s["x"][i] += gain[i] * (innovation - applied)
            s["filtered"][i] = s["x"][i]
    if p["tooth"] != tooth:
        forget_tooth(p, s["filtered"])
        forget_tooth(p, s["x"])
    _advance(p, s, s["x"], sample_cycle, now)
    s["filtered_cycle"] = sample_cycle
    s["innovation_um"] = innovation
    return True
