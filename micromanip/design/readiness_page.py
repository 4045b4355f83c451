"""The answer of ``system check`` as one page: for which machine and release it holds, and how it is known."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .page import COLOURS, INK, drawing, page, section, table

Curves = Mapping[str, tuple[NDArray[Any], NDArray[Any]]]
"""Lateness (us) and share of cycles that were later, by what was measured."""
_SOONEST_US = 0.1
"""Where the logarithmic axis begins; what was sooner stands there."""


def readiness_page(answer: Mapping[str, Any], at_rest: Curves, under_load: Curves, told: Sequence[str]) -> str:
    """`answer` is the command's JSON document, `told` are its sentences about the timed run."""
    machine, loop = answer["machine"], answer["machine"]["loop"]
    about = [
        ("time", machine["time"]),
        ("machine", f"{machine['name']}, {machine['cpus']} CPUs, {machine['processor']}"),
        ("kernel", machine["kernel"]),
        ("its parameters", machine["command_line"] or "not to be seen"),
        ("micromanip", machine["micromanip"]),
        (
            "loop",
            f"{loop['rate_hz']} Hz on CPU {loop['cpu']}, SCHED_FIFO {loop['priority']}, {loop['spin_us']:g} us spun",
        ),
    ]
    findings = answer["findings"]
    mended = [(each["name"], each["why"], each["mend"]) for each in findings if each["mend"]]
    parts = [
        f"<p><strong>{html.escape(answer['verdict'])}</strong></p>",
        table(("it holds for", ""), about, words=True),
        "<h2>Settings</h2>",
        table(
            ("setting", "", "found"),
            [(each["name"], str(each["verdict"]), each["found"]) for each in findings],
            words=True,
        ),
    ]
    if mended:
        parts += ["<h2>What would mend it</h2>", table(("setting", "why it matters", "how"), mended, words=True)]
    if answer["timed"] is not None:
        parts += [_timed(answer["timed"], at_rest, under_load)]
        parts += [f"<p>{html.escape(line)}</p>" for line in told]
    return page(f"Real-time check of {machine['name']}", parts)


def _timed(timed: Mapping[str, Any], at_rest: Curves, under_load: Curves) -> str:
    rows, head = [], ("us", "p50", "p99", "p99.9", "p99.99", "max")
    for when in ("at_rest", "under_load"):
        for what in ("lateness", "compute", "cyclictest"):
            if (figures := timed[when][f"{what}_ns"]) is not None:
                called = f"{what}, {when.replace('_', ' ')}"
                rows.append([called, *(f"{value / 1e3:.1f}" for value in figures.values())])
    about = "Share of cycles that came later than that; dotted: under load."
    return section("Lateness", about, _drawn(at_rest, under_load)) + table(head, rows)


def _drawn(at_rest: Curves, under_load: Curves) -> Figure:
    figure, panels = drawing()
    for style, curves, when in (("-", at_rest, "at rest"), (":", under_load, "under load")):
        for (name, (late_us, share)), colour in zip(curves.items(), COLOURS, strict=False):
            late_us = np.maximum(late_us, _SOONEST_US)
            panels[0, 0].loglog(late_us, share, style, color=colour, label=f"{name}, {when}")
    panels[0, 0].set(xlabel="later than, us", ylabel="share of cycles")
    panels[0, 0].legend(loc="lower left", frameon=False, labelcolor=INK)
    return figure
