"""Controllers from models: the strain PID under a sensitivity limit, the outer loop by two knobs."""

from .outer import OuterDesign, tune_outer
from .pid import PidDesign, tune_pid

__all__ = ["OuterDesign", "PidDesign", "tune_outer", "tune_pid"]
