"""Figures of a run, as ``status`` and ``run --json`` report them."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt import mailbox as w
from micromanip.rt.histogram import percentile
from micromanip.rt.states import SHADOW_NAMES
from micromanip.settings.schema.reference import Tracker
from micromanip.settings.wiring.timing import signal_timing
from micromanip.status_reply import (
    AxisValues,
    Durations,
    LearningStatus,
    Link,
    PathError,
    Recorded,
    SignalFigures,
    Status,
)

from .axis_values import AxesValues
from .controller import Controller
from .ring import RingReader
from .sample_rates import SampleRates

_ROLES = (("strain", 1), ("stage", 2), ("deviation", 4))
_MOST_ROWS = 1 << 15
_PERCENTILES = (0.5, 0.99, 0.999, 0.9999)
_SPLIT_BITS = 8
_SPLIT = 1 << _SPLIT_BITS
_OCTAVES = 40
"""Ages in us: twelve days."""


class Gathered:
    """What the host takes out of the telemetry ring: signals, axes; each row is read once."""

    def __init__(self, controller: Controller) -> None:
        self._reader = RingReader(controller.ring)
        self.signals = SignalStatistics(controller)
        self.rates = SampleRates(controller)
        self._axes = AxesValues(controller)

    def gather(self) -> None:
        """Take in the rows since the last call."""
        rows = self._reader.read(_MOST_ROWS)
        self.signals.add(rows)
        self.rates.add(rows)
        self._axes.add(rows)

    def axes(self) -> dict[str, AxisValues]:
        """What each axis does now."""
        return self._axes.report(self._reader.latest(), time.monotonic_ns())


class SignalStatistics:
    """Rate, age and losses of each signal."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._names = list(controller.prepared.configuration.axes)
        self._fresh: Counter[str] = Counter()
        self._cycles: Counter[str] = Counter()
        self._ages: dict[str, Ages] = {}
        self._late: Counter[str] = Counter()
        self._stale: Counter[str] = Counter()

    def add(self, rows: Any) -> None:
        """Take in rows of the telemetry ring."""
        for i, axis in enumerate(self._names):
            for role, bit in _ROLES:
                name = f"{role}_{axis}"
                if name not in self._controller.prepared.configuration.signals:
                    continue
                fresh = rows["axis"]["fresh"][:, i] & bit != 0
                first = 0
                if not self._fresh[name]:  # before the first sample there is no age and no rate
                    first = int(np.argmax(fresh)) if fresh.any() else len(rows)
                self._fresh[name] += int(np.count_nonzero(fresh))
                self._cycles[name] += int(rows["periods"][first:].sum())
                ages_us = rows["axis"][f"{role}_age_ns"][first:, i] // 1000
                limit_us = self._controller.prepared.configuration.signals[name].max_age_us
                too_old = ages_us > (np.inf if limit_us is None else limit_us)
                self._late[name] += int(np.count_nonzero(too_old & fresh[first:]))
                self._stale[name] += int(np.count_nonzero(too_old))
                self._ages.setdefault(name, Ages()).add(ages_us)

    def report(self) -> dict[str, SignalFigures]:
        """What was gathered, by the signals' names."""
        period_s = self._controller.prepared.configuration.loop.period_ns * 1e-9
        report: dict[str, SignalFigures] = {}
        missing, wiring = self._controller.missing(), self._controller.prepared.wiring
        for name, ages in self._ages.items():
            role, axis = name.rsplit("_", 1)
            state = self._controller.status["state"][0]["axis"][self._names.index(axis)][role]
            unseen = int(state["unseen"])
            lost = min(missing.get(wiring.signal(name), unseen), unseen)
            report[name] = {
                "rate_hz": round(self._fresh[name] / max(1, self._cycles[name]) / period_s, 1),
                "stated_hz": round(signal_timing(self._controller.prepared.configuration, wiring, name).rate_hz, 3),
                "age_p50_us": ages.percentile(0.5),
                "age_p99_9_us": ages.percentile(0.999),
                "age_max_us": ages.maximum,
                "lost": lost,
                "superseded": unseen - lost,
                "refused": int(state["refused"]),
                "samples": int(state["samples"]),
                "late": self._late[name],
                "stale_cycles": self._stale[name],
            }
        return report


def durations(histogram: Any, maximum: int) -> Durations:
    """Percentiles and maximum (ns) of one of the loop's histograms."""
    p50, p99, p99_9, p99_99 = (int(percentile(histogram, share)) for share in _PERCENTILES)
    return Durations(p50=p50, p99=p99, p99_9=p99_9, p99_99=p99_99, max=int(maximum))


def path_errors(controller: Controller) -> dict[str, PathError]:
    """Path error (um) of each axis since a second after tracking began; None where there is none."""
    report: dict[str, PathError] = {}
    deviates = isinstance(controller.prepared.configuration.reference, Tracker)
    for i, name in enumerate(controller.prepared.configuration.axes):
        a = controller.status["state"][0]["figures"][i]
        count = int(a["errors"])
        if count == 0 or not np.isfinite(a["error_squares"]):
            report[name] = PathError(uncompensated_rms=None, rms=None, max=None)
            continue
        told = controller.prepared.parameters[0]["axis"][i]["uncompensated"] >= 0
        uncompensated = round(float(np.sqrt(a["uncompensated_squares"] / count)), 4)
        report[name] = {
            "uncompensated_rms": uncompensated if deviates or told else None,
            "rms": round(float(np.sqrt(a["error_squares"] / count)), 4),
            "max": round(float(a["error_max"]), 4),
        }
    return report


def report(
    controller: Controller,
    gathered: Gathered,
    trips: Sequence[Any] = (),
    links: Mapping[str, Link] | None = None,
    recording: Recorded | None = None,
    learning: LearningStatus | None = None,
) -> Status:
    """The whole report of a run, up to now; `trips` are those that have a black box, `links` the buses."""
    gathered.gather()
    words, faults = controller.words, controller.faults()
    return {
        "state": controller.state,
        "cycles": int(words[w.CYCLES_RUN]),
        "overruns": int(words[w.OVERRUNS]),
        "period_ns": controller.prepared.configuration.loop.period_ns,
        "lateness_ns": durations(controller.status["lateness"], words[w.LATENESS_MAX_NS]),
        "compute_ns": durations(controller.status["compute"], words[w.COMPUTE_MAX_NS]),
        "path_error_um": path_errors(controller),
        "axes": gathered.axes(),
        "signals": gathered.signals.report(),
        "slow_signals": gathered.rates.slow(),
        "faults": [str(fault) for fault in faults],
        "fault_reports": [fault.document() for fault in faults],
        "parameter_version": int(words[w.VERSION_ACTIVE]),
        "candidate": SHADOW_NAMES[int(words[w.SHADOW])],
        "configuration": str(controller.prepared.source.path),
        "configuration_sha256": controller.prepared.source.hash,
        "trips": list(trips),
        "links": dict(links or {}),
        "recording": recording,
        "learning": learning,
    }


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
