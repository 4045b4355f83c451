"""What ``run`` and ``status`` show people: one live line, and the table of figures."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from micromanip.host import journal

_PLAIN_EVERY_S = 2.0
_STYLES = {"TRACKING": "bold green", "FAULT": "bold red", "RAMPING": "yellow", "ARMED": "yellow"}


def one_line(report: dict[str, Any]) -> str:
    """The state of the controller in one line."""
    seconds = report["cycles"] * report["period_ns"] * 1e-9
    errors = " ".join(
        f"{axis} {figures['rms']:.2f}"
        for axis, figures in report["path_error_um"].items()
        if figures["rms"] is not None
    )
    late, compute = report["lateness_ns"]["p99_9"] / 1e3, report["compute_ns"]["p50"] / 1e3
    line = f"{seconds:7.1f} s  overruns {report['overruns']}  late p99.9 {late:.2f} us  compute p50 {compute:.1f} us"
    return line + (f"  error rms {errors} um" if errors else "")


class LiveLine:
    """A line on standard error that is rewritten on a terminal, and repeated now and then elsewhere.

    In the journal of a service there are messages only: the service manager shows the state.
    """

    def __init__(self) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._live = Live(console=self._console, refresh_per_second=5, transient=True) if sys.stderr.isatty() else None
        self._journal = journal.leads_to_journal()
        self._told = 0.0

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def say(self, message: str) -> None:
        """A message that stays."""
        if self._journal and journal.send(message):
            return
        style = "bold red" if message.startswith(("X-", "WARNING")) else ""
        self._console.print(Text(message, style=style), soft_wrap=True)  # one line also in a log file

    def show(self, report: dict[str, Any]) -> None:
        """The live line."""
        state = Text(f"{report['state']:9}", style=_STYLES.get(report["state"], ""))
        line = state + Text(one_line(report))
        if self._live is not None:
            self._live.update(line)
        elif not self._journal and time.monotonic() - self._told > _PLAIN_EVERY_S:
            self._told = time.monotonic()
            self._console.print(line, soft_wrap=True)


def summary(report: dict[str, Any]) -> None:
    """Timing and path error of a run as tables on standard output."""
    console = Console(highlight=False)
    seconds = report["cycles"] * report["period_ns"] * 1e-9
    console.print(
        f"{report['cycles']} cycles in {seconds:.1f} s, {report['overruns']} overruns, state {report['state']}"
    )
    timing = Table("", "p50", "p99", "p99.9", "p99.99", "max", title="Timing, us")
    for name, key in (("lateness", "lateness_ns"), ("compute", "compute_ns")):
        figures = report[key]
        timing.add_row(name, *(f"{figures[k] / 1e3:.2f}" for k in ("p50", "p99", "p99_9", "p99_99", "max")))
    console.print(timing)
    errors = Table("axis", "uncompensated rms", "rms", "max", "better by", title="Path error at the spindle, um")
    shown = False
    for axis, figures in report["path_error_um"].items():
        if figures["rms"]:
            better = figures["uncompensated_rms"] / figures["rms"]
            errors.add_row(
                axis,
                f"{figures['uncompensated_rms']:.1f}",
                f"{figures['rms']:.3f}",
                f"{figures['max']:.2f}",
                f"{better:.0f} times",
            )
            shown = True
    if shown:
        console.print(errors)
    for fault in report["faults"]:
        console.print(Text(fault, style="bold red"))
