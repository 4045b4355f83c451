"""Linear dynamics from recordings by subspace identification: one or many inputs, outputs, experiments."""

from .fit import fit_linear
from .modal import Modes
from .model import LinearFit

__all__ = ["LinearFit", "Modes", "fit_linear"]
