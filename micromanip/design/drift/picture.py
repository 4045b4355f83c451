"""The checks of an axis as curves: each figure beside what its drawn plants span, each margin beside its limit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from micromanip.design.canvas import panels
from micromanip.settings.schema.accept import Accept

from .history import COLUMNS, LABELS, MARGINS, Check
from .judged import DRAWN, Judged


def picture(checks: Sequence[Check], judged: Judged, accept: Accept) -> Figure:
    """`checks` of one axis under one tuning, oldest first."""
    shown = [name for name in COLUMNS if not all(np.isnan(check.figures[name]) for check in checks)]
    figure, axes = panels(len(shown), f"Axis {judged.axis}: {judged.checks} checks", 0.35 * len(shown))
    found = {each.name: each for each in judged.watched}
    least = dict(zip(MARGINS, (accept.gain_margin_dB, accept.phase_margin_deg), strict=True))
    time = [check.time for check in checks]
    for panel, name in zip(axes, shown, strict=True):
        panel.plot(time, [check.figures[name] for check in checks], "o-", ms=3, lw=0.8, color="tab:blue")
        panel.set_ylabel(LABELS[name], fontsize="small")
        panel.grid(alpha=0.3)
        panel.label_outer()
        if name in least:
            panel.axhline(least[name], color="tab:red", lw=1, ls="--")
            continue
        if not np.isnan(found[name].commissioned):
            panel.axhline(found[name].commissioned, color="tab:orange", lw=1, label="model")
            if name in DRAWN:
                for share in DRAWN[name]:
                    panel.axhline(found[name].commissioned * share, color="tab:red", lw=1, ls="--")
        if (since := found[name].since) is not None:
            panel.axvline(since, color="tab:red", lw=1)
            panel.set_title(f"drifts since {since:%Y-%m-%d %H:%M}", fontsize="small", color="tab:red", loc="right")
    figure.autofmt_xdate()
    return figure
