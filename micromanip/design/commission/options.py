"""What a human may ask of a commissioning."""

from __future__ import annotations

from dataclasses import dataclass

from micromanip.settings.schema.axis import Axis


@dataclass(frozen=True)
class Options:
    """None leaves a figure to the margins and to what was measured."""

    bandwidth_Hz: float | None = None
    noise_um: float | None = None
    tooth_Hz: float | None = None
    """Tooth-passing frequency that the outer loop cancels; None leaves it to the axis' own section `outer`."""
    tooth_seen_Hz: float | None = None
    """The one that was seen, for an axis without that section; None: nothing is cancelled, unless it sees one."""

    def tooth(self, settings: Axis) -> float | None:
        """Tooth-passing frequency (Hz) that the outer loop of an axis with these settings is to cancel."""
        if self.tooth_Hz is not None:
            return self.tooth_Hz
        return settings.outer.oscillation_Hz if settings.outer else self.tooth_seen_Hz
