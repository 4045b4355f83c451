"""What each axis does, as rows of text: position, set-point, strain, voltage, headroom and error, now and before."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from rich.console import Group, RenderableType
from rich.text import Text

from micromanip.status_reply import NO_SIGNAL, AxisValues, Status, Value, Window

from .tables import Figures

_NOTE = "rms and peak: of an error about zero, else about the mean; of the headroom the least"
_UNKNOWN = "unknown"
_TIGHT_V = 5.0
"""Headroom that is worth a colour."""


@dataclass(frozen=True)
class Row:
    """One quantity of one axis."""

    name: str
    """With its unit."""
    now: Text
    second: tuple[str, str]
    """Rms and peak."""
    minute: tuple[str, str]
    why: str | None
    """Why it is not known now."""


def rows(axis: AxisValues) -> Iterator[Row]:
    """Each quantity of an axis, in the order in which the signal runs; none of a sensor that the axis does not have."""
    error = "error, um" if axis["error_of"] is None else f"{axis['error_of']} error, um"
    if _is_wired(axis["position_um"]):
        yield _row("position, um", axis["position_um"])
    yield _row("set-point, um", axis["setpoint_um"])
    if _is_wired(axis["strain_um"]):
        yield _row("strain, um", axis["strain_um"])
    yield _row("voltage, V", axis["voltage_V"])
    yield _headroom(axis["headroom_V"])
    yield _row(error, axis["error_um"], about_zero=True)


def values(report: Status) -> RenderableType:
    """All axes; why a value is unknown stands below."""
    named = {name: list(rows(axis)) for name, axis in report["axes"].items()}
    reasons: dict[str, list[str]] = {}
    for name, axis_rows in named.items():
        for row in axis_rows:
            if row.why is not None:
                reasons.setdefault(row.why, []).append(f"{name} {row.name.partition(',')[0]}")
    count = sum(map(len, named.values()))
    told = (
        Text(f"unknown: {'every value' if len(who) == count else ', '.join(who)}: {why}", style="yellow")
        for why, who in reasons.items()
    )
    table = Figures("", "now", "1 s rms", "peak", "1 min rms", "peak", title="Axes", caption=_NOTE)
    for column in table.columns[1:]:
        column.justify = "right"
    for name, axis_rows in named.items():
        for row in axis_rows:
            table.add_row(f"{name} {row.name}", row.now, *row.second, *row.minute)
        table.add_section()
    return Group(table, *told)


def _is_wired(value: Value) -> bool:
    return not (value["unknown"] or "").startswith(NO_SIGNAL)


def _row(name: str, value: Value, *, about_zero: bool = False) -> Row:
    rms, peak = ("rms", "peak") if about_zero else ("deviation_rms", "deviation_peak")
    second, minute = (
        ("-", "-") if window is None else (f"{window[rms]:.3f}", f"{window[peak]:.3f}")  # type: ignore[literal-required]
        for window in (value["second"], value["minute"])
    )
    return Row(name, _now(value), second, minute, value["unknown"])


def _headroom(value: Value) -> Row:
    row = Row("headroom, V", _now(value), _least(value["second"]), _least(value["minute"]), value["unknown"])
    if value["latest"] is not None and value["latest"] < _TIGHT_V:
        row.now.stylize("bold yellow")
    return row


def _least(window: Window | None) -> tuple[str, str]:
    return ("-", "-") if window is None else ("", f"{window['min']:.3f}")


def _now(value: Value) -> Text:
    if value["latest"] is None:
        return Text("stale" if (value["unknown"] or "").startswith("stale") else _UNKNOWN, style="yellow")
    return Text(f"{value['latest']:.3f}")
