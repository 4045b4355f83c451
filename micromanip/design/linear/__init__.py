"""Linear dynamics from recordings by subspace identification: one or many inputs, outputs, experiments."""

from .fit import LinearFit, fit_linear
from .modal import Modes

__all__ = ["LinearFit", "Modes", "fit_linear"]
