"""Loop transfers of the strain loop and the outer loop, their margins, and how both bear another plant."""

from micromanip.control.margins import Margins, grid, refined
from micromanip.control.stage_loop import model_system, stage_loop
from micromanip.control.system import System

from .monte_carlo import HELD_SENSITIVITY, Sample, StageSide, StrainSide, held_plant, monte_carlo, worst
from .perturbation import SPREAD, draw
from .strain_loop import over_path, strain_loop

__all__ = [
    "HELD_SENSITIVITY",
    "SPREAD",
    "Margins",
    "Sample",
    "StageSide",
    "StrainSide",
    "System",
    "draw",
    "grid",
    "held_plant",
    "model_system",
    "monte_carlo",
    "over_path",
    "refined",
    "stage_loop",
    "strain_loop",
    "worst",
]
