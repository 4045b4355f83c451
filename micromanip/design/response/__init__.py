"""Frequency responses measured with periodic multisines, with their confidence, and rational models of them."""

from .choice import Identified, Wanted, identify
from .excitation import Multisine, multisine
from .measured import Measured, measure, of_spectra

__all__ = ["Identified", "Measured", "Multisine", "Wanted", "identify", "measure", "multisine", "of_spectra"]
