"""Loop transfers of the strain loop and the outer loop, their margins, and how both bear another plant."""

from micromanip.control.margins import Margins, curve_margins, grid, margins, refined
from micromanip.control.pid import pid_system
from micromanip.control.stage_loop import model_system, stage_loop
from micromanip.control.system import System, delay, from_state_space

from .monte_carlo import HELD_SENSITIVITY, Sample, StageSide, StrainSide, held_plant, monte_carlo, worst
from .perturbation import SPREAD, Perturbation, draw
from .strain_loop import closed_ratio, over_path, strain_loop

__all__ = [
    "HELD_SENSITIVITY",
    "SPREAD",
    "Margins",
    "Perturbation",
    "Sample",
    "StageSide",
    "StrainSide",
    "System",
    "closed_ratio",
    "curve_margins",
    "delay",
    "draw",
    "from_state_space",
    "grid",
    "held_plant",
    "margins",
    "model_system",
    "monte_carlo",
    "over_path",
    "pid_system",
    "refined",
    "stage_loop",
    "strain_loop",
    "worst",
]
