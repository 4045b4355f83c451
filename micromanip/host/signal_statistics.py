"""Rate, age and losses of each sensor, and whether its samples come as often as its driver states.

Filters and gains are made for the stated rate. A gauge that comes at a third of it is no fault, and nothing stops for
it; its axis only acts by the calm gains for good (W-217, which speaks of samples that are missing). So it is told for
what it is, with figures, while it is so.

Judged is the median interval between samples, which neither a burst of losses nor an interrupted beam changes, in
cycles that ran: what the loop misses is not the sensor's doing. What came and was refused, at an end of a range for
instance, came all the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.settings.wiring.timing import signal_timing
from micromanip.status_reply import SignalFigures

from .controller import Controller

_ROLES = (("strain", 1), ("stage", 2), ("deviation", 4))
_TOO_LONG, _TOO_FEW = 1.5, 0.75
"""Of the stated interval, and of the stated rate; both must be so. Gains bear twice the interval, with less margin."""
_LEAST_S, _INTERVALS, _LEAST_INTERVALS = 1.0, 60, 8
_SPLIT_BITS = 8
_SPLIT = 1 << _SPLIT_BITS
_OCTAVES = 40
"""Ages in us: twelve days."""


class Ages:
    """Ages (us): each power of two is split into 256 equal bins, so percentiles are good to .4 %, to 512 us exact."""

    def __init__(self) -> None:
        self.maximum: int | None = None
        self._counts = np.zeros(_SPLIT * (_OCTAVES - _SPLIT_BITS + 1), np.int64)

    def add(self, ages_us: NDArray[np.int64]) -> None:
        """Count some more; negative ones as 0."""
        if not len(ages_us):
            return
        ages_us = np.maximum(ages_us, 0)
        oldest = int(ages_us.max())
        self.maximum = oldest if self.maximum is None else max(self.maximum, oldest)
        shift = np.maximum(np.frexp(ages_us.astype(float))[1] - 1 - _SPLIT_BITS, 0)
        bins = np.minimum(shift * _SPLIT + (ages_us >> shift), len(self._counts) - 1)
        self._counts += np.bincount(bins, minlength=len(self._counts))

    def percentile(self, share: float) -> int | None:
        """Lower edge (us) of the bin up to which there are `share` of all; None without any."""
        seen = np.cumsum(self._counts)
        if seen[-1] == 0:
            return None
        index = int(np.searchsorted(seen, max(1.0, share * seen[-1])))
        shift = max(0, index // _SPLIT - 1)
        return (index - shift * _SPLIT) << shift


@dataclass
class _Signal:
    """What is gathered of one signal: of the whole run, and of the block that is judged next."""

    axis: int
    role: str
    bit: int
    fresh: int = 0
    cycles: int = 0
    late: int = 0
    stale: int = 0
    ages: Ages = field(default_factory=Ages)
    rows: int = 0
    refused: int | None = None
    """What the loop had refused of it when the block began."""
    samples: list[int] = field(default_factory=list)
    """Rows with a fresh sample, counted from the block's begin."""


class SignalStatistics:
    """Follows the sensors of one controller, row by row; a row is a cycle that ran."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        configuration = controller.prepared.configuration
        self._signals = {
            f"{role}_{axis}": _Signal(i, role, bit)
            for i, axis in enumerate(configuration.axes)
            for role, bit in _ROLES
            if f"{role}_{axis}" in configuration.signals
        }
        self._slow: dict[str, str] = {}
        self._told: set[str] = set()

    def add(self, rows: Any) -> None:
        """Take in rows of the telemetry ring."""
        for name, signal in self._signals.items():
            fresh = rows["axis"]["fresh"][:, signal.axis] & signal.bit != 0
            self._count(name, signal, rows, fresh)
            refused = int(self._state(signal)["refused"])
            signal.refused = refused if signal.refused is None else signal.refused
            signal.samples += (np.flatnonzero(fresh) + signal.rows).tolist()
            signal.rows += len(rows)
            stated_hz = self._stated_hz(name)
            if signal.rows >= max(_LEAST_S, _INTERVALS / stated_hz) * self._rate_hz:
                self._slow.pop(name, None)
                if len(signal.samples) > _LEAST_INTERVALS:  # silent, or nearly: others tell
                    self._judge(name, signal, refused - signal.refused, stated_hz)
                signal.rows, signal.samples, signal.refused = 0, [], refused

    def report(self) -> dict[str, SignalFigures]:
        """What was gathered, by the signals' names."""
        missing, wiring = self._controller.missing(), self._controller.prepared.wiring
        report: dict[str, SignalFigures] = {}
        for name, signal in self._signals.items():
            state = self._state(signal)
            unseen = int(state["unseen"])
            lost = min(missing.get(wiring.signal(name), unseen), unseen)
            report[name] = {
                "rate_hz": round(signal.fresh / max(1, signal.cycles) * self._rate_hz, 1),
                "stated_hz": round(self._stated_hz(name), 3),
                "age_p50_us": signal.ages.percentile(0.5),
                "age_p99_9_us": signal.ages.percentile(0.999),
                "age_max_us": signal.ages.maximum,
                "lost": lost,
                "superseded": unseen - lost,
                "refused": int(state["refused"]),
                "samples": int(state["samples"]),
                "late": signal.late,
                "stale_cycles": signal.stale,
            }
        return report

    def slow(self) -> list[str]:
        """Each signal that comes less often than is stated, a sentence."""
        return list(self._slow.values())

    def news(self) -> Iterator[str]:
        """Those of `slow` that were not in it before."""
        for name in self._slow.keys() - self._told:
            self._told.add(name)
            yield self._slow[name]

    @property
    def _rate_hz(self) -> float:
        return 1e9 / self._controller.prepared.configuration.loop.period_ns

    def _state(self, signal: _Signal) -> Any:
        return self._controller.status["state"][0]["axis"][signal.axis][signal.role]

    def _stated_hz(self, name: str) -> float:
        """What the driver of a signal states, at most the loop's own rate."""
        prepared = self._controller.prepared
        return signal_timing(prepared.configuration, prepared.wiring, name).rate_hz

    def _count(self, name: str, signal: _Signal, rows: Any, fresh: NDArray[np.bool_]) -> None:
        first = 0
        if not signal.fresh:  # before the first sample there is no age and no rate
            first = int(np.argmax(fresh)) if fresh.any() else len(rows)
        signal.fresh += int(np.count_nonzero(fresh))
        signal.cycles += int(rows["periods"][first:].sum())
        ages_us = rows["axis"][f"{signal.role}_age_ns"][first:, signal.axis] // 1000
        limit_us = self._controller.prepared.configuration.signals[name].max_age_us
        too_old = ages_us > (np.inf if limit_us is None else limit_us)
        signal.late += int(np.count_nonzero(too_old & fresh[first:]))
        signal.stale += int(np.count_nonzero(too_old))
        signal.ages.add(ages_us)

    def _judge(self, name: str, signal: _Signal, refused: int, stated_hz: float) -> None:
        """Tell, with figures and the next step, where it comes less often than is stated."""
        interval = float(np.median(np.diff(signal.samples)))
        came_hz = (len(signal.samples) + refused) / signal.rows * self._rate_hz
        if interval < _TOO_LONG * self._rate_hz / stated_hz or came_hz > _TOO_FEW * stated_hz:
            return
        comes_hz, driver = self._rate_hz / interval, self._controller.prepared.configuration.signals[name].driver
        doing = ""
        if signal.role == "strain" and comes_hz < 0.5 * stated_hz:
            doing = ", and its axis acts by its calm gains as long as that lasts (W-217)"
        self._slow[name] = (
            f"{name} comes {comes_hz:.0f} times a second, its driver {driver} states {stated_hz:.0f}: "
            f"the loops are made for that{doing}. Let the device send as often, or state the rate that comes in "
            f"drivers.{driver} and commission again"
        )
