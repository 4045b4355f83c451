"""Identification, synthesis and evaluation: plain functions on arrays, offline."""

from .linear import LinearFit, fit_linear

__all__ = ["LinearFit", "fit_linear"]
