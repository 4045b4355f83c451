"""Table 1 of the paper and the experiment behind it, equation (25)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from micromanip.settings.schema.axis import Inner
from micromanip.settings.schema.reference import Sine, Sines

from ..report.model import Table

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
_OWN = "own PID + tanh inverse, with what the section actuator undoes"
LABELS = {"A": "PID", "B": "PID + affine inverse", "C": "PID + tanh inverse"}

ANCHOR_PID = Inner(mode="pid", K_V_per_um=0.6, Ti_ms=0.571, Td_ms=0.167, filter_ms=0.3)
"""The one tuning of all three configurations, found for the simulated plant so that A is the paper's A."""


def reference(frequency_hz: float, start_s: float) -> Sines:
    """Equation (25) on the actuator side; rests at the offset until `start_s`."""
    sine = Sine(amplitude_um=AMPLITUDE_UM, frequency_Hz=frequency_hz)
    return Sines(source="sine", offset_um=OFFSET_UM, start_s=start_s, sines=(sine,))


def beside_the_paper(rows: Sequence[dict[str, Any]]) -> Table:
    """`rows` of :func:`.evaluation.table` with the paper's figure in brackets, where it has one."""
    labels = LABELS | {row["config"]: _OWN for row in rows if row["config"] not in LABELS}
    shown = []
    for row in rows:
        hertz, config = row["frequency_hz"], row["config"]
        true = (row["true_std_error_um"], 3), (row["true_max_error_um"], 2)
        shown.append((
            row["axis"], f"{hertz:g}", config,
            _beside(f"{row['std_error_um']:.3f}", SIGMA_UM.get(config, {}).get(hertz), 3),
            _beside(f"{row['max_error_um']:.2f}", MAXIMUM_UM.get(config, {}).get(hertz), 2),
            f"{row['max_error_with_start_um']:.2f}",
            *("-" if value is None else f"{value:.{digits}f}" for value, digits in true),
        ))  # fmt: skip
    meant = ", ".join(f"{letter} {label}" for letter, label in labels.items())
    caption = f"Control error on the actuator side, um (the paper's figure in brackets): {meant}"
    return Table(caption, ("axis", "Hz", "", "sigma", "maximum", "with start", "true sigma", "true max"), shown)


def _beside(value: str, papers: float | None, digits: int) -> str:
    return value if papers is None else f"{value} ({papers:.{digits}f})"


def swinging(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A sentence for each axis and configuration that swings by itself: its figures say nothing of the models."""
    found: dict[tuple[str, str], float] = {}
    for row in rows:
        if row["swings_hz"] is not None:
            found.setdefault((row["axis"], row["config"]), row["swings_hz"])
    return [
        f"{config}, axis {axis}: the strain loop swings by itself at {hertz:.0f} Hz, most of the error: its PID is not "
        "for this actuator, and the figures say nothing of the models"
        for (axis, config), hertz in found.items()
    ]
