"""What an axis does in a cycle: chosen by the cell's state, carried out by ``axis.py``."""

from __future__ import annotations

PARKED, CHECKING_GAUGE, LIFTING, CHECKING_STAGE, SWEEPING, CLOSED, PARKING, FROZEN = range(8)
"""Rests at the park voltage; makes a small voltage step (check of the gauge); is brought to its working point with
the inner loop; makes a small step there (check of the stage); is swept with falling amplitude; follows the
reference; goes back to the park voltage; keeps its voltage."""
DRIVEN = (LIFTING, CHECKING_STAGE, SWEEPING, CLOSED)
"""With its law at work."""

PHASE_NAMES = (
    "parked",
    "gauge check",
    "lift",
    "stage check",
    "sweep",
    "closed",
    "parking",
    "frozen",
)
