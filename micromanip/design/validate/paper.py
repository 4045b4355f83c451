"""Table 1 of the paper and the experiment behind it, equation (25)."""

from __future__ import annotations

from micromanip.settings.schema.axis import Inner
from micromanip.settings.schema.reference import Sine, Sines

FREQUENCIES_HZ = (1.0, 5.0, 10.0)
OFFSET_UM, AMPLITUDE_UM = 70.0, 30.0

SIGMA_UM = {
    "A": {1.0: 0.174, 5.0: 0.835, 10.0: 1.63},
    "B": {1.0: 0.0632, 5.0: 0.125, 10.0: 0.131},
    "C": {1.0: 0.0629, 5.0: 0.106, 10.0: 0.118},
}
MAXIMUM_UM = {
    "A": {1.0: 0.829, 5.0: 2.65, 10.0: 4.68},
    "B": {1.0: 0.505, 5.0: 0.823, 10.0: 0.592},
    "C": {1.0: 0.525, 5.0: 0.739, 10.0: 0.590},
}
LABELS = {"A": "PID", "B": "PID + affine inverse", "C": "PID + tanh inverse"}

ANCHOR_PID = Inner(mode="pid", K_V_per_um=0.6, Ti_ms=0.571, Td_ms=0.167, filter_ms=0.3)
"""The one tuning of all three configurations, found for the simulated plant so that A is the paper's A."""


def reference(frequency_hz: float, start_s: float) -> Sines:
    """Equation (25) on the actuator side; rests at the offset until `start_s`."""
    sine = Sine(amplitude_um=AMPLITUDE_UM, frequency_Hz=frequency_hz)
    return Sines(source="sine", offset_um=OFFSET_UM, start_s=start_s, sines=(sine,))
