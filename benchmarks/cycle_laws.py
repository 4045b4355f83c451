"""One cycle with every law that an axis in mode stage can have, beside the cycle of the configuration as it is.

A notch, a tooth that is followed, axes that are decoupled, and a learned correction that is played. The cell that has
them is the same one; whether it is tuned well by them is not asked here.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.rt.laws.learned import PLAYS
from micromanip.rt.records import MAX_AXES
from micromanip.settings.check import Prepared, prepare, prepared
from micromanip.settings.text.source import Source

from .cycle import REPEATS, STRETCH_CYCLES, TRACKING_S, timed
from .recording import Outcome, Recording, ours, record_tracking
from .runner import Plan, Result


def run(plan: Plan) -> list[Result]:
    """Nanoseconds a cycle; the ratio is the median over the pairs."""
    plain = record_tracking(prepare(plan.configuration), TRACKING_S, STRETCH_CYCLES)
    full = with_a_correction(record_tracking(with_every_law(plan.configuration), TRACKING_S, STRETCH_CYCLES))
    rooms = [Outcome.room(STRETCH_CYCLES) for _ in range(2)]
    played = [(ours, full, rooms[0]), (ours, plain, rooms[1])]
    _require_all(full, rooms[0])
    plan.tell(f"cycle_laws: {plan.pairs} pairs of {STRETCH_CYCLES * REPEATS} cycles")
    taken = timed(played, plan.pairs)
    value, reference = np.median(taken, axis=0)
    ratio = float(np.median(taken[:, 0] / taken[:, 1]))
    return [Result("cycle_laws", float(value), "ns", "the configuration as it is", float(reference), ratio)]


def with_every_law(file: Path) -> Prepared:
    """The configuration with all these laws switched on. Raises ConfigError where it can't have them."""
    source = Source.read(file)
    data: dict[str, Any] = dict(source.data)
    names = list(data["axes"])
    data["axes"] = {
        name: _axis(axis, [other for other in names if other != name]) for name, axis in data["axes"].items()
    }
    return prepared(Source.of(data, file))


def _axis(axis: dict[str, Any], others: list[str]) -> dict[str, Any]:
    return axis | {
        "inner": axis["inner"] | {"notch": {"frequency_Hz": 700.0, "width_Hz": 50.0}},
        "outer": axis["outer"] | {"oscillation_range_percent": 2.0},
        "coupling": {"share": dict.fromkeys(others, 0.005), "decouple": True},
    }


def with_a_correction(recording: Recording) -> Recording:
    """The same stretch in the middle of a part whose correction is played on every axis."""
    rows = 2 * len(recording.signals)
    parameters, state = recording.parameters.copy(), recording.state.copy()
    samples = np.zeros((2 * rows, MAX_AXES))
    samples[:rows] = 0.01 * np.sin(0.02 * np.arange(rows))[:, None]
    begun = int(state["cycle"][0]) - 1
    state["part"], state["part_begun"] = 1, begun
    for i in range(int(parameters["axes"][0])):
        p, s = parameters["axis"][0, i]["learned"], state["axis"][0, i]["learned"]
        p["number"], p["rows"], p["column"], p["fade_cycles"] = 1, rows, i, 100
        p["limit_um"], p["tolerance_um"], p["cycles_per_s"] = 1.0, 1e6, 1e4
        s["number"], s["part"], s["why"], s["level"] = 1, begun, PLAYS, 1.0
    return dataclasses.replace(recording, parameters=parameters, state=state, samples=samples)


def _require_all(recording: Recording, outcome: Outcome) -> None:
    """Raises CheckFailed where a law is not at work at the end: its cost would not be in the figure."""
    ours(recording, outcome, 1)
    for i in range(int(recording.parameters["axes"][0])):
        p, s = recording.parameters["axis"][0, i], outcome.state["axis"][0, i]
        if not (
            s["learned"]["why"] == PLAYS
            and p["outer"]["tooth"] != 0
            and p["pid"]["notch_share"] > 0.0
            and s["added_um"] != 0.0
        ):
            raise CheckFailed(f"axis {i} does not run with every law")
