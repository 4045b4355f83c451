"""Controllers from models: the strain PID under a sensitivity limit, what its feedforward undoes, the outer loop."""

from .actuator import Undone, undo
from .outer import OuterDesign, tune_outer
from .pid import PidDesign, tune_pid
from .saturation import Reach

__all__ = ["OuterDesign", "PidDesign", "Reach", "Undone", "tune_outer", "tune_pid", "undo"]
