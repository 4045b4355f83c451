"""Frequency responses measured with periodic multisines, with their confidence, and rational models of them."""

from .choice import Identified, Recorded, Wanted, identify, identify_again
from .measured import PERIOD_S, Measured, Multisine, measure, multisine, of_spectra, smoothed

__all__ = [
    "PERIOD_S",
    "Identified",
    "Measured",
    "Multisine",
    "Recorded",
    "Wanted",
    "identify",
    "identify_again",
    "measure",
    "multisine",
    "of_spectra",
    "smoothed",
]
