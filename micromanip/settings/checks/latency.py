"""How old a tracker's samples may be, beside how long the loop can do without one: told, not refused.

The loop knows the signal's course for ``reference.horizon_ms`` after a sample. One that comes later and is further than
``jump_um`` from the last counts as a jump while the axis follows: it and all after it are refused, until X-301, which
comes after ``faults.reference.time_ms`` without a usable sample, whatever the signal's ``max_age_us`` says.
"""

from __future__ import annotations

from collections.abc import Iterator

from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker
from micromanip.settings.text.place import Finding


def latency_warnings(configuration: Configuration) -> Iterator[Finding]:
    """Limits that end a healthy cell, whose samples are no older than their ``max_age_us`` says they may be.

    A signal without a limit promises nothing, and nothing is said of it. Nothing of the horizon where a path can't be
    further from its last sample than it may jump.
    """
    reference = configuration.reference
    if not isinstance(reference, Tracker):
        return
    oldest_ms = {name: _oldest_ms(configuration, name) for name in configuration.axes}
    longest_ms = max(oldest_ms.values())
    span_um = reference.range_um[1] - reference.range_um[0]
    if reference.jump_um is not None and reference.jump_um < span_um and longest_ms > reference.horizon_ms:
        yield (
            ("reference", "horizon_ms"),
            f"{reference.horizon_ms:g} ms are less than the {longest_ms:g} ms that a sample of the tracker may be old "
            f"(max_age_us): a path that has moved by more than jump_um, {reference.jump_um:g} um, when one comes later "
            f"is taken for a jump and lost; write {longest_ms:g}, or max_age_us: {1e3 * reference.horizon_ms:g}",
        )
    for name, axis in configuration.axes.items():
        time_ms = axis.faults.reference.time_ms
        if time_ms is not None and time_ms < oldest_ms[name]:
            yield (
                ("axes", name, "faults", "reference", "time_ms"),
                f"X-301 after {time_ms:g} ms without a sample of the tracker, which may be {oldest_ms[name]:g} ms old "
                f"(max_age_us); write {oldest_ms[name]:g}, or max_age_us: {1e3 * time_ms:g}",
            )


def _oldest_ms(configuration: Configuration, axis: str) -> float:
    """How old what the axis follows may become, in ms; 0 where nothing says so."""
    frame = configuration.frame
    followed = (f"deviation_{axis}",) if frame is None else frame.sources
    ages_us = (signal.max_age_us for name in followed if (signal := configuration.signals.get(name)))
    return 1e-3 * max((age_us for age_us in ages_us if age_us is not None), default=0.0)
