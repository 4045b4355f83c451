"""How far a stage goes, and what of a tracker's range it can't follow: told, not refused.

The range of a tracker says which deviations are believed. One that is believed and out of reach is followed to the end
of the set-point's range and back from there; were it refused, the path would be lost instead (X-301).
"""

from __future__ import annotations

from micromanip.control.outer_gains import dc_gain
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker

_WORTH = 1.1
"""How much more must be reached on the nearer side before another working point is advised."""


def stage_reach_um(axis: Axis, centre_um: float | None = None) -> tuple[float, float]:
    """Lowest and highest stage position (um) by the model of `axis`, without force; another `centre_um` on request."""
    gain, centre_um = dc_gain(axis.outer), axis.centre_um if centre_um is None else centre_um
    low, high = sorted((end - centre_um) * gain for end in axis.setpoint.range_um)
    return low, high


def reach_warnings(configuration: Configuration) -> list[str]:
    """A sentence for each axis in mode stage that reaches less than the tracker may ask for."""
    reference, told = configuration.reference, []
    if not isinstance(reference, Tracker):
        return []
    for name, axis in configuration.axes.items():
        if axis.mode != "stage":
            continue
        low, high = stage_reach_um(axis)
        if low <= reference.range_um[0] and high >= reference.range_um[1]:
            continue
        middle_um = 0.5 * sum(axis.setpoint.range_um)
        lowest, highest = stage_reach_um(axis, middle_um)
        advice = ""
        if min(-lowest, highest) > _WORTH * min(-low, high):
            advice = (
                f"; with centre_um at the middle of its set-points, {middle_um:.3g} um, it would reach {lowest:.0f} to "
                f"{highest:.0f} um"
            )
        told.append(
            f"axis {name} reaches {low:.0f} to {high:.0f} um by its model, without force, of the "
            f"{reference.range_um[0]:g} to {reference.range_um[1]:g} um of reference.range_um: beyond, its set-point "
            f"stays at its end and the rest of the deviation is left{advice}"
        )
    return told
