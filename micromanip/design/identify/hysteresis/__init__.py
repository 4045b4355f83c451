"""Hysteresis models of an actuator, fitted to recordings: plain functions on arrays.

fitted = fit(structure_of("pi-tanh", voltage_V, step_s), voltage_V, displacement_um, (0.0, 130.0))
fitted.rms_percent, fitted.predict(other_voltage_V), fitted.model
"""

from .choice import Candidate, candidates, choose
from .fit import HysteresisFit, fit, structure_of
from .kernel import inverse

__all__ = ["Candidate", "HysteresisFit", "candidates", "choose", "fit", "inverse", "structure_of"]
