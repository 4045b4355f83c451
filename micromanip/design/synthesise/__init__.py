"""Controllers from models: the strain PID under a sensitivity limit, what its feedforward undoes, the outer loop."""

from ..analyse.saturation import Reach
from .actuator import InvertedActuator, invert_actuator
from .outer import OuterDesign, tune_outer
from .pid import PidDesign, tune_pid

__all__ = ["InvertedActuator", "OuterDesign", "PidDesign", "Reach", "invert_actuator", "tune_outer", "tune_pid"]
