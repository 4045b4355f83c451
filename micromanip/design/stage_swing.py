"""Which sines of the actuator the stage bears: it swings with them, and far where its flexure resonates.

The strain loop follows a sine at the flexure's resonance as it does any other, as nothing of it is fed back from the
stage. With H from set-point to stage, H_0 at rest, a sine of amplitude A that begins at once moves the stage by

    A (|H| + sqrt(|H| |H - H_0|))

at most: of a mode without damping at omega_0 this is exact, as ``H = H_0 / (1 - r^2)``, ``r = omega / omega_0``, and
what begins with the sine swings on at omega_0 by ``r |H|``. H is measured by sines that are small.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class StageSwing:
    """Of one axis: H (lines,) at `hertz` (lines,), the lowest for H_0, the stage at rest (um), what its sensor sees."""

    hertz: NDArray[np.float64]
    answer: NDArray[np.complex128]
    rest_um: float
    range_um: tuple[float, float]

    def refusal(self, frequency_hz: float, amplitude_um: float) -> str | None:
        """Why a sine must not be played; None where the stage stays where it is seen."""
        steady = abs(np.interp(frequency_hz, self.hertz, self.answer))
        begun = abs(np.interp(frequency_hz, self.hertz, self.answer - self.answer[0]))
        swing_um = amplitude_um * float(steady + np.sqrt(steady * begun))
        low_um, high_um = self.range_um
        if low_um < self.rest_um - swing_um and self.rest_um + swing_um < high_um:
            return None
        return (
            f"the stage would swing by up to {swing_um:.0f} um about {self.rest_um:.0f} um, and its sensor sees "
            f"{low_um:g} to {high_um:g} um"
        )
