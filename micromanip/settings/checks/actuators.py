"""Whether a loop of this rate can undo what an axis' section ``actuator`` says, and remembers for long enough."""

from __future__ import annotations

from collections.abc import Iterator

from micromanip.rt.laws.estimator import INPUT_HISTORY
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.place import Finding

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
