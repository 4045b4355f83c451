"""What ``run`` and ``status`` show people: one live line, and the table of figures."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from functools import partial
from types import TracebackType
from typing import Literal, Self

from rich.console import Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from micromanip.faults import FaultReport
from micromanip.host import journal
from micromanip.status_reply import NO_SIGNAL, AxisValues, LearningStatus, Link, Recorded, Status, Value, Window

from .messages import Printer, error_console
from .tables import Figures, out_console

_NOTE = "rms and peak: of an error about zero, else about the mean; of the headroom the least"
_HEADROOM, _SENSORS = "headroom, V", ("position, um", "strain, um")
_TIGHT_V = 5.0
"""Headroom that is worth a colour."""


def values(report: Status) -> RenderableType:
    """What each axis does; why a value is unknown stands below."""
    table = Figures("", "now", "1 s rms", "peak", "1 min rms", "peak", title="Axes", caption=_NOTE)
    for column in table.columns[1:]:
        column.justify = "right"
    reasons: dict[str, list[str]] = {}
    for name, axis in report["axes"].items():
        for said, value in _quantities(axis):
            figures = (figure for over in ("second", "minute") for figure in _over(said, value[over]))
            table.add_row(f"{name} {said}", _now(said, value), *figures)
            if value["unknown"] is not None:
                reasons.setdefault(value["unknown"], []).append(f"{name} {said.partition(',')[0]}")
        table.add_section()
    told = (
        Text(f"unknown: {'every value' if len(who) == table.row_count else ', '.join(who)}: {why}", style="yellow")
        for why, who in reasons.items()
    )
    return Group(table, *told)


def _quantities(axis: AxisValues) -> Iterator[tuple[str, Value]]:
    """With their names, in the order in which the signal runs; none of a sensor that the axis does not have."""
    for said, value in (
        ("position, um", axis["position_um"]),
        ("set-point, um", axis["setpoint_um"]),
        ("strain, um", axis["strain_um"]),
        ("voltage, V", axis["voltage_V"]),
        (_HEADROOM, axis["headroom_V"]),
        (f"{axis['error_of'] or ''} error, um".lstrip(), axis["error_um"]),
    ):
        if not (value["unknown"] or "").startswith(NO_SIGNAL) or said not in _SENSORS:
            yield said, value


def _over(said: str, window: Window | None) -> tuple[str, str]:
    """Rms and peak, or the least headroom, over a second or a minute."""
    if window is None:
        return "-", "-"
    if said == _HEADROOM:
        return "", f"{window['min']:.3f}"
    if said.endswith("error, um"):
        return f"{window['rms']:.3f}", f"{window['peak']:.3f}"
    return f"{window['deviation_rms']:.3f}", f"{window['deviation_peak']:.3f}"


def _now(said: str, value: Value) -> Text:
    latest = value["latest"]
    if latest is None:
        return Text("stale" if (value["unknown"] or "").startswith("stale") else "unknown", style="yellow")
    return Text(f"{latest:.3f}", style="bold yellow" if said == _HEADROOM and latest < _TIGHT_V else "")


_PLAIN_EVERY_S = 2.0
_COLUMNS: tuple[Literal["p50", "p99", "p99_9", "p99_99", "max"], ...] = ("p50", "p99", "p99_9", "p99_99", "max")
_AGES: tuple[Literal["age_p50_us", "age_p99_9_us", "age_max_us"], ...] = ("age_p50_us", "age_p99_9_us", "age_max_us")
_UNUSED: tuple[Literal["lost", "superseded", "late"], ...] = ("lost", "superseded", "late")
_STYLES = {
    "TRACKING": "bold green",
    "FAULT": "bold red",
    "HOLDING": "bold yellow",
    "RAMPING": "yellow",
    "ARMING": "yellow",
}


def one_line(report: Status) -> str:
    """The run in one line; the error is that of the last second."""
    seconds = report["cycles"] * report["period_ns"] * 1e-9
    last_second = {axis: values["error_um"]["second"] for axis, values in report["axes"].items()}
    errors = " ".join(f"{axis} {window['rms']:.2f}" for axis, window in last_second.items() if window is not None)
    late, compute = report["lateness_ns"]["p99_9"] / 1e3, report["compute_ns"]["p50"] / 1e3
    line = f"{seconds:7.1f} s  overruns {report['overruns']}  late p99.9 {late:.2f} us  compute p50 {compute:.1f} us"
    return line + (f"  error rms {errors} um" if errors else "")


class LiveLine:
    """A line on standard error that is rewritten on a terminal, and repeated now and then elsewhere.

    In the journal of a service there are messages only: the service manager shows the state. Nothing here waits.
    """

    def __init__(self) -> None:
        self.planned_s: float | None = None
        """How long the run takes, where that is known: then a bar with the time left stands beside the line."""
        self._console, self._printer = error_console(), Printer()
        self._live = Live(console=self._console, refresh_per_second=5, transient=True) if sys.stderr.isatty() else None
        self._journal = journal.is_connected()
        self._told = 0.0

    def __enter__(self) -> Self:
        self._printer.__enter__()
        if self._live is not None:
            self._printer.do(self._live.start)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._printer.do(self._live.stop)
        self._printer.__exit__(kind, value, trace)

    def say(self, told: str | FaultReport) -> None:
        """A message or a fault, that stays."""
        if self._journal and journal.send(journal.fields(told)):
            return
        is_grave = not told.kind.is_warning if isinstance(told, FaultReport) else told.startswith("WARNING")
        text = Text(str(told), style="bold red" if is_grave else "")
        self._printer.do(lambda: self._console.print(text, soft_wrap=True))  # one line also in a log file

    def show(self, report: Status) -> None:
        """The live line."""
        line = state_line(report) if self.planned_s is None else _with_time_left(report, self.planned_s)
        if self._live is not None:
            self._printer.do(partial(self._live.update, line))
        elif not self._journal and time.monotonic() - self._told > _PLAIN_EVERY_S:
            self._told = time.monotonic()
            self._printer.do(lambda: self._console.print(line, soft_wrap=True))


def _with_time_left(report: Status, planned_s: float) -> RenderableType:
    done_s = min(report["cycles"] * report["period_ns"] * 1e-9, planned_s)
    shown = Table.grid(padding=(0, 1))
    shown.add_row(ProgressBar(planned_s, done_s, width=20), f"{planned_s - done_s:.0f} s left", state_line(report))
    return shown


def summary(report: Status) -> None:
    """Timing and path error of a run on standard output."""
    out_console().print(figures(report))


def status(report: Status) -> None:
    """State, faults, what each axis does, and the figures of the run, on standard output."""
    console = out_console()
    console.print(state_line(report), *faults(report), *slow_signals(report), *tuning(report), sep="\n")
    console.print(values(report), *_figures(report))


def figures(report: Status) -> Group:
    """The run in one line, its figures as tables."""
    seconds = report["cycles"] * report["period_ns"] * 1e-9
    line = f"{report['cycles']} cycles in {seconds:.1f} s, {report['overruns']} overruns, state {report['state']}"
    return Group(line, *_figures(report))


def faults(report: Status) -> list[Text]:
    """What is latched, and what to do."""
    return [Text(fault, style="bold red") for fault in report["faults"]]


def slow_signals(report: Status) -> list[Text]:
    """Sensors that come less often than their drivers state."""
    return [Text(told, style="bold yellow") for told in report["slow_signals"]]


def tuning(report: Status) -> list[Text]:
    """Axes that nobody has tuned, what the commissioning of the others did not reach, and those that swing."""
    untuned = [name for name, axis in report["axes"].items() if axis["untuned"]]
    told = [f"axis {', '.join(untuned)}: UNTUNED, in open loop: `micromanip commission`"] if untuned else []
    for name, axis in report["axes"].items():
        if axis["less"]:
            told.append(f"axis {name}: PASS WITH LESS: {axis['less']}")
        if axis["swing"]:
            told.append(
                f"axis {name}: SWINGS by {axis['swing']['um']:g} um at {axis['swing']['Hz']:g} Hz, its reference held: "
                "its loop, or a vibration; `micromanip analyse live` tells which"
            )
    return [Text(each, style="bold yellow") for each in told]


def _figures(report: Status) -> list[RenderableType]:
    """Timing, path error, buses, recording."""
    timing = Figures("", "p50", "p99", "p99.9", "p99.99", "max", title="Timing, us")
    for name, times in (("lateness", report["lateness_ns"]), ("compute", report["compute_ns"])):
        timing.add_row(name, *(f"{times[k] / 1e3:.2f}" for k in _COLUMNS))
    parts: list[RenderableType] = [timing]
    errors = Figures("axis", "uncompensated rms", "rms", "max", "better by", title="Path error at the spindle, um")
    for axis, error in report["path_error_um"].items():
        if error["rms"] is not None and error["max"] is not None:
            without = error["uncompensated_rms"]
            better = "-" if not (without and error["rms"]) else f"{without / error['rms']:.0f} times"
            told = "-" if without is None else f"{without:.1f}"
            errors.add_row(axis, told, f"{error['rms']:.3f}", f"{error['max']:.2f}", better)
    if errors.row_count:
        parts.append(errors)
    if report["links"]:
        parts.append(links(report))
    if report["candidate"] != "none":
        parts.append(f"candidate tuning: {report['candidate']}; see `micromanip candidate show`")
    learning = report["learning"]
    if learning is not None:
        parts.append(f"learning: {learned(learning)}; see `micromanip learn status`")
    recording = report["recording"]
    if recording is not None:
        parts.append(recorded(recording))
    return parts


def learned(learning: LearningStatus) -> str:
    """What is played of what was learned, in a few words."""
    now = ", ".join(f"{name} {axis['state']}" for name, axis in learning["axes"].items())
    return f"{learning['state']}, {learning['made']} parts made; {now}"


def recorded(recording: Recorded) -> Text:
    """How far the recording is, or why it ended."""
    if recording["message"] is not None:
        return Text(f"recording: {recording['message']}", style="bold red")
    size = f", {recording['bytes'] / 1e6:.1f} MB" if recording.get("bytes") else ""
    dropped = f", {recording['dropped']} cycles are missing" if recording["dropped"] else ""
    done = f"{recording['rows']} cycles{size}"
    return Text(f"recording: {recording['file']}, {recording['state']}, {done}{dropped}")


def links(report: Status) -> Figures:
    """Each bus: where its link stands, what its outputs do, and what its driver counts."""
    table = Figures("bus", "link", "outputs", "times up", "received", "lost", "sent", "errors", "", title="Buses")
    for name, link in report["links"].items():
        counts = (str(link["counts"].get(key, 0)) for key in ("received", "lost", "performed", "errors"))
        table.add_row(
            name,
            Text(link["link"], style="green" if link["link"] == "up" else "bold red"),
            outputs_text(link),
            str(link["links"]),
            *counts,
            link["message"] or "",
        )
    return table


def outputs_text(link: Link) -> str:
    """What the outputs do; where nobody knows, the values that the device was given last."""
    if link["outputs"] != "unknown":
        return link["outputs"]
    lasts = [f"{name} {value:g}" for name, value in link["given"].items() if value is not None]
    return f"unknown, last {', '.join(lasts)}" if lasts else "unknown, never given"


def details(report: Status) -> Group:
    """What each axis does, the figures of the run and of each signal, and what runs."""
    signals = Figures(
        "signal", "Hz", "stated", "age p50, us", "p99.9", "max", "lost", "superseded", "late", title="Signals"
    )
    for name, signal in report["signals"].items():
        rates = (f"{rate_hz:.0f}" for rate_hz in (signal["rate_hz"], signal["stated_hz"]))
        ages = (str(signal[key]) if signal[key] is not None else "-" for key in _AGES)
        signals.add_row(name, *rates, *ages, *(str(signal[key]) for key in _UNUSED))
    running = f"parameter version {report['parameter_version']}, {report['configuration']}"
    return Group(*tuning(report), values(report), *_figures(report), signals, Text(running, style="dim"))


def state_line(report: Status) -> Text:
    """The state, in its colour, and the run in one line."""
    return Text(f"{report['state']:9}", style=_STYLES.get(report["state"], "")) + Text(one_line(report))
