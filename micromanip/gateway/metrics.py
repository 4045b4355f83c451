"""What Prometheus fetches: made at each fetch, in base units, out of the status and the loop's histograms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from prometheus_client import CollectorRegistry, GCCollector, ProcessCollector
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4, generate_latest
from prometheus_client.registry import Collector

from micromanip.faults import BY_NAME
from micromanip.rt.mailbox import BINS, TRIPS, lower_edge
from micromanip.rt.states import STATE_NAMES
from micromanip.status_reply import Status

from .cell import Cell

_BOUNDS_NS = [round(mantissa * 10**exponent) for exponent in range(2, 8) for mantissa in (1, 2, 5)]
"""Upper bounds of the buckets: 100 ns to 50 ms."""
_EDGES_NS = np.array([lower_edge(k) for k in range(BINS - 1)], np.float64)
_OVER = ("second", "minute")


class Metrics(Collector):
    """Of one cell, and of the gateway itself."""

    media_type = CONTENT_TYPE_PLAIN_0_0_4

    def __init__(
        self,
        cell: Cell,
        connections: Callable[[], int],
        refused: Callable[[], int],
        expiries: Callable[[], Mapping[str, float]] = dict,
    ) -> None:
        """`expiries` has the Unix times at which certificates in use expire, by the names of their files."""
        self._cell, self._connections, self._refused, self._expiries = cell, connections, refused, expiries
        self._registry = CollectorRegistry()
        self._registry.register(self)
        ProcessCollector(registry=self._registry)
        GCCollector(registry=self._registry)

    def text(self) -> bytes:
        """In Prometheus' text format."""
        return generate_latest(self._registry)

    def describe(self) -> Iterable[Metric]:
        """Nothing is known before the first fetch."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Every family; those of the controller only while it answers."""
        status, source = self._cell.status, self._cell.source
        yield _gauge("up", "1 while the controller answers, else 0.", status is not None)
        yield _gauge("gateway_connections", "Connections of clients to the gateway.", self._connections())
        yield _counter("gateway_refused", "Connections that the gateway has refused.", self._refused())
        if expiries := {(name,): seconds for name, seconds in self._expiries().items()}:
            what = "When a certificate in use expires, Unix time."
            yield _labelled("gateway_certificate_expiry_timestamp_seconds", what, ["certificate"], expiries)
        if source is not None:
            yield _counter("gateway_rows_seen", "Rows of telemetry that the gateway has read.", source.history.count)
            yield _counter("gateway_rows_lost", "Rows overwritten before the gateway read them.", source.reader.lost)
        if status is None or source is None:
            return
        yield from _of_cell(status)
        yield _counter("faults", "Faults latched since the start.", int(source.status["words"][TRIPS]))
        for name, what in (("lateness", "How late a cycle began."), ("compute", "Time that a cycle took.")):
            yield _histogram(f"{name}_seconds", f"{what} The sum is good to 3 %.", source.status[name])
            yield _gauge(f"{name}_max_seconds", f"{what} The longest.", status[f"{name}_ns"]["max"] * 1e-9)  # type: ignore[literal-required]
        yield from _of_axes(status)
        yield from _of_signals(status)
        yield from _of_links(status)
        yield from _of_recording(status)


def _of_cell(status: Status) -> Iterator[Metric]:
    yield _labelled("state", "1 for the state that the cell is in.", ["state"], {
        (name,): name == status["state"] for name in STATE_NAMES
    })  # fmt: skip
    yield _counter("cycles", "Cycles run.", status["cycles"])
    yield _counter("overruns", "Deadlines missed.", status["overruns"])
    yield _gauge("period_seconds", "Period of the loop.", status["period_ns"] * 1e-9)
    yield _gauge("parameter_version", "Number of the set of parameters in force.", status["parameter_version"])
    latched = {fault["code"] for fault in status["fault_reports"]}
    yield _labelled("fault_latched", "1 while this fault is latched.", ["code", "fault"], {
        (kind.code, name): kind.code in latched for name, kind in BY_NAME.items() if not kind.is_warning
    })  # fmt: skip


def _of_axes(status: Status) -> Iterator[Metric]:
    axes = status["axes"]
    for quantity, name, unit in (
        ("position_um", "position_meters", "Position of the stage."),
        ("setpoint_um", "setpoint_meters", "Set-point of the actuator."),
        ("strain_um", "strain_meters", "Position of the actuator by its gauge."),
        ("voltage_V", "voltage_volts", "Voltage of the actuator."),
        ("headroom_V", "headroom_volts", "Voltage left to the nearer end of the range."),
        ("error_um", "error_meters", "Error of the path, or of the gauge where no path is controlled."),
    ):
        scale = 1e-6 if quantity.endswith("_um") else 1.0
        values = {axis: of_axis[quantity] for axis, of_axis in axes.items()}  # type: ignore[literal-required]
        now = {(axis,): v["latest"] * scale for axis, v in values.items() if v["latest"] is not None}
        yield _labelled(f"axis_{name}", unit, ["axis"], now)
        over = [(axis, window, v[window]) for axis, v in values.items() for window in _OVER if v[window] is not None]
        if quantity == "error_um":
            for figure in ("rms", "peak"):
                yield _labelled(f"axis_error_{figure}_meters", f"Error, {figure} of this window.", ["axis", "window"], {
                    (axis, window): figures[figure] * scale for axis, window, figures in over
                })  # fmt: skip
        if quantity == "headroom_V":
            yield _labelled("axis_headroom_min_volts", "Least headroom of this window.", ["axis", "window"], {
                (axis, window): figures["min"] for axis, window, figures in over
            })  # fmt: skip
    tooth = {(axis,): hertz for axis, v in axes.items() if (hertz := v["tooth_Hz"]) is not None}
    yield _labelled("axis_tooth_hertz", "Frequency of the tooth, where it is followed.", ["axis"], tooth)
    joints = {
        (axis, str(k)): hertz
        for axis, v in axes.items()
        for k, hertz in enumerate(v["joints_Hz"], 1)
        if hertz is not None
    }
    told = "Frequency of an oscillation of the joints, where it is followed."
    yield _labelled("axis_joint_hertz", told, ["axis", "oscillation"], joints)


def _of_signals(status: Status) -> Iterator[Metric]:
    signals = status["signals"]
    rates = {(name,): s["rate_hz"] for name, s in signals.items()}
    yield _labelled("signal_rate_hertz", "Fresh samples of a signal in a second.", ["signal"], rates)
    stated = {(name,): s["stated_hz"] for name, s in signals.items()}
    yield _labelled("signal_stated_rate_hertz", "What the driver of a signal states of that.", ["signal"], stated)
    ages = {
        (name, percentile): age * 1e-6
        for name, s in signals.items()
        for percentile, age in (("50", s["age_p50_us"]), ("99.9", s["age_p99_9_us"]), ("100", s["age_max_us"]))
        if age is not None
    }
    yield _labelled("signal_age_seconds", "Age of a signal's newest sample.", ["signal", "percentile"], ages)
    for key, what in (
        ("lost", "Samples of a signal that never came."),
        ("superseded", "Samples of a signal that came with a newer one, or while the loop missed cycles."),
        ("refused", "Samples of a signal that were bad, or not to be believed."),
        ("stale_cycles", "Cycles without a usable sample."),
    ):
        counts = {(name,): s[key] for name, s in signals.items()}  # type: ignore[literal-required]
        yield _labelled(f"signal_{key}", what, ["signal"], counts, CounterMetricFamily)


def _of_links(status: Status) -> Iterator[Metric]:
    links = status["links"]
    yield _labelled("link_up", "1 while the link of a bus is up.", ["driver"], {
        (name,): link["link"] == "up" for name, link in links.items()
    })  # fmt: skip
    for name, what in (("links", "How often a link came up."), ("starts", "Starts of a bus worker.")):
        counts = {(driver,): link[name] for driver, link in links.items()}  # type: ignore[literal-required]
        yield _labelled(f"link_{'ups' if name == 'links' else name}", what, ["driver"], counts, CounterMetricFamily)


def _of_recording(status: Status) -> Iterator[Metric]:
    recording: Any = status["recording"]
    told = {} if recording is None else recording
    yield _gauge("recording_up", "1 while a recording is made.", told.get("state") == "recording")
    yield _counter("recording_rows", "Rows recorded.", told.get("rows", 0))
    yield _counter("recording_dropped_rows", "Rows that could not be recorded.", told.get("dropped", 0))


def _gauge(name: str, what: str, value: float) -> Metric:
    return GaugeMetricFamily(f"micromanip_{name}", what, float(value))


def _counter(name: str, what: str, value: float) -> Metric:
    return CounterMetricFamily(f"micromanip_{name}", what, float(value))


def _labelled(
    name: str, what: str, labels: list[str], values: Mapping[Any, float], kind: Any = GaugeMetricFamily
) -> Metric:
    family: Metric = kind(f"micromanip_{name}", what, labels=labels)
    for of, value in values.items():
        family.add_metric(of, float(value))  # type: ignore[attr-defined]
    return family


def _histogram(name: str, what: str, counts: Any) -> Metric:
    """Of the loop's histogram: a bin counts below a bound where all of it is."""
    counts = np.array(counts[: len(_EDGES_NS)], np.float64)
    upper = np.r_[_EDGES_NS[1:], np.inf]
    buckets = [(f"{bound * 1e-9:g}", float(counts[upper <= bound].sum())) for bound in _BOUNDS_NS]
    buckets.append(("+Inf", float(counts.sum())))
    middles = np.r_[(_EDGES_NS[1:] + _EDGES_NS[:-1]) / 2.0, _EDGES_NS[-1]]
    return HistogramMetricFamily(
        f"micromanip_{name}", what, buckets=buckets, sum_value=float((counts * middles).sum() * 1e-9)
    )
