"""Figures of a run, as ``status`` and ``run --json`` report them."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from micromanip.rt import mailbox as w
from micromanip.rt.bus_image import FOLLOWING, OUTPUT_NAMES, UNKNOWN
from micromanip.rt.mailbox import lower_edge
from micromanip.rt.states import OFF, SHADOW_NAMES, STATE_NAMES
from micromanip.settings.schema.reference import Tracker
from micromanip.status_reply import AxisValues, Durations, LearningStatus, Link, PathError, Recorded, Status

from .axis_values import AxesValues
from .controller import Controller
from .shared_memory import RingReader
from .signal_statistics import SignalStatistics

_MOST_ROWS = 1 << 15
_PERCENTILES = (0.5, 0.99, 0.999, 0.9999)


def percentile(histogram: Any, fraction: float) -> int:
    """Smallest bin edge (ns) that at least `fraction` of all values do not exceed by a bin; 0 when empty."""
    seen = np.cumsum(histogram)
    if seen[-1] == 0:
        return 0
    return lower_edge(int(np.searchsorted(seen, max(1, math.ceil(fraction * seen[-1])))))


class Gathered:
    """What the host takes out of the telemetry ring: signals, axes; each row is read once."""

    def __init__(self, controller: Controller) -> None:
        self._reader = RingReader(controller.ring)
        self.signals = SignalStatistics(controller)
        self._axes = AxesValues(controller)

    def gather(self) -> None:
        """Take in the rows since the last call."""
        rows = self._reader.read(_MOST_ROWS)
        self.signals.add(rows)
        self._axes.add(rows)

    def axes(self) -> dict[str, AxisValues]:
        """What each axis does now."""
        return self._axes.report(self._reader.latest(), time.monotonic_ns())


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


def _seen_from(state: str, link: Link) -> Link:
    """A link as its worker told it before the cell's state was asked for: a loop that has ended is not followed."""
    over = state == STATE_NAMES[OFF] and link["outputs"] == OUTPUT_NAMES[FOLLOWING]
    return {**link, "outputs": OUTPUT_NAMES[UNKNOWN]} if over else link


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
    words, faults, state = controller.words, controller.faults(), controller.state
    return {
        "state": state,
        "cycles": int(words[w.CYCLES_RUN]),
        "overruns": int(words[w.OVERRUNS]),
        "period_ns": controller.prepared.configuration.loop.period_ns,
        "lateness_ns": durations(controller.status["lateness"], words[w.LATENESS_MAX_NS]),
        "compute_ns": durations(controller.status["compute"], words[w.COMPUTE_MAX_NS]),
        "path_error_um": path_errors(controller),
        "axes": gathered.axes(),
        "signals": gathered.signals.report(),
        "slow_signals": gathered.signals.slow(),
        "faults": [str(fault) for fault in faults],
        "fault_reports": [fault.document() for fault in faults],
        "parameter_version": int(words[w.VERSION_ACTIVE]),
        "candidate": SHADOW_NAMES[int(words[w.SHADOW])],
        "configuration": str(controller.prepared.source.path),
        "configuration_sha256": controller.prepared.source.hash,
        "trips": list(trips),
        "links": {name: _seen_from(state, link) for name, link in (links or {}).items()},
        "recording": recording,
        "learning": learning,
    }
