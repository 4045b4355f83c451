"""What an axis adds to its set-point for the references of the others: shares of the set-point, and its lead."""

from __future__ import annotations

from typing import Any

from micromanip.control.outer_gains import dc_gain, steady_lag
from micromanip.settings.schema.model import Configuration

_NEXT_CYCLE = 1
"""The references of a cycle are answered in the next one."""


def fill_decoupling(d: Any, configuration: Configuration, name: str) -> None:
    """Fill a DECOUPLING_PARAMETERS record for axis `name`: between axes in mode stage, where that is asked for."""
    axis = configuration.axes[name]
    if axis.coupling is None or not axis.coupling.decouple or axis.mode != "stage" or axis.outer is None:
        return
    gain, period_s = dc_gain(axis.outer), configuration.loop.period_ns * 1e-9
    d["lead_s"] = (steady_lag(axis.outer) + _NEXT_CYCLE) * period_s
    for j, (other, settings) in enumerate(configuration.axes.items()):
        if settings.mode == "stage":
            d["share"][j] = axis.coupling.share.get(other, 0.0) / gain
    d["active"] = int(d["share"].any())
