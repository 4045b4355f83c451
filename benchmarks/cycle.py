"""One cycle of three axes, telemetry row included, beside the same cycle in plain C.

Both replay the same signals of the simulated cell from the same state, and must leave the same numbers
behind; then they are timed in turns. The stretch is short, so that both work in the processor's cache. In
``cycle_cold`` a neighbour on the core empties that before each cycle, as in the running loop; the median counts.
``cycle_laws`` has every law that an axis in mode stage can have, beside the configuration as it is: a notch, a tooth
that is followed, axes that are decoupled, a learned correction that is played. How well the cell is tuned by them is
not asked.
"""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.rt.laws.learned import PLAYS
from micromanip.rt.records import MAX_AXES
from micromanip.settings.check import Prepared, prepare, prepared
from micromanip.settings.text.source import Source

from .recording import Outcome, Player, Recording, ours, record_tracking
from .runner import CONFIGURATION, PAIRS, Result, Tell
from .twin import twin_player

_BEGUN_S, _COMPARED_CYCLES = 0.1, 4000
STRETCH_CYCLES, REPEATS = 500, 40
SWEPT_BYTES = 4_000_000
"""More than the caches that a core has for itself."""
TRACKING_S = 1.5
"""Long enough that the path error is scored."""
TOLERANCE = 1e-9
"""Of the largest value that the number takes, at least of 1 um or 1 V; whole numbers must be equal."""
_SCRATCH = ("scratch",)  # working memory of one function, no state
_TOLD = ("events", "event")  # the list for the host; what is raised stands in the conditions, which are compared


def run(tell: Tell) -> list[Result]:
    """Nanoseconds a cycle; the ratio is the median over the pairs. Raises CheckFailed where the two disagree."""
    cell = prepare(CONFIGURATION)
    with tempfile.TemporaryDirectory() as folder:
        twin = twin_player(Path(folder))
        _compared(record_tracking(cell, _BEGUN_S, _COMPARED_CYCLES), twin)
        stretch = record_tracking(cell, TRACKING_S, STRETCH_CYCLES)
        outcome = _compared(stretch, twin)
        tell(f"cycle: our cycle and its C twin agree; {PAIRS} pairs of {STRETCH_CYCLES * REPEATS} cycles")
        taken = timed([(ours, stretch, outcome), (twin, stretch, outcome)])
        cold = dataclasses.replace(stretch, swept=np.zeros(SWEPT_BYTES // 8, np.int64))
        swept = timed([(ours, cold, outcome), (twin, cold, outcome)], cold=True)
    full = with_a_correction(record_tracking(with_every_law(CONFIGURATION), TRACKING_S, STRETCH_CYCLES))
    room = Outcome.room(STRETCH_CYCLES)
    _require_all(full, room)
    laws = timed([(ours, full, room), (ours, stretch, outcome)])
    reference = "C twin, gcc -O3 -march=native"
    return [
        Result.of_pairs("cycle", taken, "ns", reference),
        Result.of_pairs("cycle_cold", swept, "ns", reference),
        Result.of_pairs("cycle_laws", laws, "ns", "the configuration as it is"),
    ]


def _compared(recording: Recording, twin: Player) -> Outcome:
    """Outcome of one replay, which both must agree on."""
    left, right = (Outcome.room(len(recording.signals)) for _ in range(2))
    ours(recording, left, 1)
    twin(recording, right, 1)
    require_agreement(left, right)
    return left


def timed(played: Sequence[tuple[Player, Recording, Outcome]], *, cold: bool = False) -> NDArray[np.float64]:
    """Processor time (ns) a cycle, (PAIRS, 2), of two played in turns; every other pair begins with the second.

    `cold`: the median cycle of each instead, behind its neighbour's work.
    """
    taken = np.zeros((PAIRS, 2))
    for pair in range(PAIRS):
        for which in (0, 1) if pair % 2 else (1, 0):
            player, recording, outcome = played[which]
            begin = time.thread_time_ns()
            player(recording, outcome, 1 if cold else REPEATS)
            mean_ns = (time.thread_time_ns() - begin) / (len(recording.signals) * REPEATS)
            taken[pair, which] = np.median(outcome.taken_ns) if cold else mean_ns
    return taken


def require_agreement(a: Outcome, b: Outcome) -> None:
    """Raise CheckFailed, naming field and cycle, where `a` and `b` differ by more than `TOLERANCE`."""
    for part in ("rows", "state", "outputs"):
        for name, left, right in _numbers(part, getattr(a, part), getattr(b, part)):
            _require_close(name, left, right)


def _numbers(name: str, a: NDArray[Any], b: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any], NDArray[Any]]]:
    if a.dtype.names is None:
        yield name, a, b
        return
    for field in a.dtype.names:
        if field not in _SCRATCH + _TOLD:
            yield from _numbers(f"{name}.{field}", a[field], b[field])


def _require_close(name: str, a: NDArray[Any], b: NDArray[Any]) -> None:
    if np.issubdtype(a.dtype, np.integer):
        differs = a != b
    else:
        scale = max(1.0, float(np.max(np.abs(a[np.isfinite(a)]), initial=0.0)))
        differs = ~np.isclose(a, b, rtol=0.0, atol=TOLERANCE * scale, equal_nan=True)
    if differs.any():
        place = tuple(int(i) for i in np.argwhere(differs)[0])
        raise CheckFailed(
            f"our cycle and its C twin disagree: {name} at {list(place)} is {a[place]!r} and {b[place]!r}, "
            f"{np.count_nonzero(differs)} of {differs.size} numbers differ"
        )


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
