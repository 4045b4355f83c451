"""What actuators, set-points and samples can reach: a reference that asks for more is refused, limits are told of.

The range of a tracker says which deviations are believed. One that is believed and out of reach is followed to the end
of the set-point's range and back from there; were it refused, the path would be lost instead (X-301).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from micromanip.control.outer_gains import dc_gain
from micromanip.rt.laws.estimator import INPUT_HISTORY
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.hysteresis import NoModel, PrandtlIshlinskii, attainable_um
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import File, Hold, Jog, Reference, Sines, Step, Tracker
from micromanip.settings.text.place import Finding

# The loop knows the signal's course for ``reference.horizon_ms`` after a sample. One that comes later and is further
# than ``jump_um`` from the last counts as a jump while the axis follows: it and all after it are refused, until X-301,
# which comes after ``faults.reference.time_ms`` without a usable sample, whatever the signal's ``max_age_us`` says.


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


_FASTEST = 0.45
"""Highest frequency of a filter as a share of the rate: beyond, no sample shows its upper half."""
_LONGEST = INPUT_HISTORY // 2
"""Cycles that an answer may take: the rest of the memory is the bus' and the gauge's."""


def actuator_findings(configuration: Configuration) -> Iterator[Finding]:
    """What can't be undone, or awaited."""
    rate_hz = configuration.loop.rate_hz
    for name, axis in configuration.axes.items():
        if axis.actuator is None:
            continue
        path: tuple[str | int, ...] = ("axes", name, "actuator")
        for i, each in enumerate(axis.actuator.resonances):
            for key in ("resonance_Hz", "antiresonance_Hz"):
                if getattr(each, key) > _FASTEST * rate_hz:
                    yield (
                        (*path, "resonances", i, key),
                        f"{getattr(each, key):g} Hz can't be undone at {rate_hz} Hz: {_FASTEST * rate_hz:g} Hz at most",
                    )
        awaited_us, longest_us = axis.actuator.delay_us + axis.actuator.gauge_us, 1e6 * _LONGEST / rate_hz
        if awaited_us > longest_us:
            told = f"delay_us and gauge_us are {awaited_us:g} us together: at most {longest_us:g} us at {rate_hz} Hz"
            yield path, told


_WORTH = 1.1
"""How much more must be reached on the nearer side before another working point is advised."""


def range_findings(configuration: Configuration) -> Iterator[Finding]:
    """Set-points beyond the hysteresis model, models beyond themselves, and a reference that no set-point gives."""
    reference = configuration.reference
    low, high = _excursion(reference)
    for name, axis in configuration.axes.items():
        reachable, unit = axis.setpoint.range_um, "um"
        if not isinstance(axis.hysteresis, NoModel) and axis.mode != "voltage":
            least, most = axis.hysteresis.range_um
            if least > reachable[0] or most < reachable[1]:
                yield (
                    ("axes", name, "setpoint", "range_um"),
                    f"{list(reachable)} um goes beyond the hysteresis model's range_um {[least, most]}",
                )
            if isinstance(axis.hysteresis, PrandtlIshlinskii):
                lowest, highest = attainable_um(axis.hysteresis)
                if least < lowest or most > highest:
                    yield (
                        ("axes", name, "hysteresis", "range_um"),
                        f"{[least, most]} um is more than the tanh shaping can reach: {lowest:.4g} to {highest:.4g} um",
                    )
        wanted = low, high
        if axis.mode == "stage":
            gain = dc_gain(axis.outer)
            if not (np.isfinite(gain) and gain):
                yield (
                    ("axes", name, "outer", "model"),
                    f"its steady gain is {gain:g}; the stage must follow the set-point",
                )
                continue
            if isinstance(reference, Tracker):
                continue  # `range_warnings`
            ends = axis.centre_um + low / gain, axis.centre_um + high / gain
            wanted = min(ends), max(ends)
        elif isinstance(reference, Tracker):
            wanted = axis.centre_um + low, axis.centre_um + high
        if axis.mode == "voltage":
            output = configuration.outputs.get(f"voltage_{name}")
            reachable, unit = (output.range_V if output else (-np.inf, np.inf)), "V"
        if isinstance(reference, File):
            continue
        if wanted[0] < reachable[0] - 1e-9 or wanted[1] > reachable[1] + 1e-9:
            yield (
                ("reference",),
                f"axis {name} can't reach it: the reference asks for {wanted[0]:.4g}..{wanted[1]:.4g} {unit} "
                f"of the actuator, its range is {reachable[0]:.4g}..{reachable[1]:.4g} {unit}",
            )


def range_warnings(configuration: Configuration) -> Iterator[Finding]:
    """Each axis in mode stage that reaches less than the tracker may ask for."""
    reference = configuration.reference
    if not isinstance(reference, Tracker):
        return
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
        yield (
            ("axes", name, "setpoint", "range_um"),
            f"axis {name} reaches {low:.0f} to {high:.0f} um by its model, without force, of the "
            f"{reference.range_um[0]:g} to {reference.range_um[1]:g} um of reference.range_um: beyond, its set-point "
            f"stays at its end and the rest of the deviation is left{advice}",
        )


def stage_reach_um(axis: Axis, centre_um: float | None = None) -> tuple[float, float]:
    """Lowest and highest stage position (um) by the model of `axis`, without force; another `centre_um` on request."""
    gain, centre_um = dc_gain(axis.outer), axis.centre_um if centre_um is None else centre_um
    low, high = sorted((end - centre_um) * gain for end in axis.setpoint.range_um)
    return low, high


def _excursion(reference: Reference) -> tuple[float, float]:
    """Lowest and highest value the reference can take."""
    if isinstance(reference, Tracker):
        return reference.range_um
    if isinstance(reference, Jog):
        return reference.range_um
    if isinstance(reference, Step):
        ends = (reference.offset_um, reference.offset_um + reference.step_um)
        return min(ends), max(ends)
    if isinstance(reference, Sines):
        reach = sum(abs(sine.amplitude_um) for sine in reference.sines)
        return reference.offset_um - reach, reference.offset_um + reach
    return (reference.offset_um, reference.offset_um) if isinstance(reference, Hold) else (0.0, 0.0)
