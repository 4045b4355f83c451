"""Whether a plant is still the one that was commissioned: its figures measured again and again, and what they do."""

from .cusum import Cusum, average_run_length, change_point, limit_for
from .figures import FIGURES, PlantFigures, commissioned, plant_figures
from .history import Check, append, read_history
from .judged import Judged, Watched, judge

__all__ = [
    "FIGURES",
    "Check",
    "Cusum",
    "Judged",
    "PlantFigures",
    "Watched",
    "append",
    "average_run_length",
    "change_point",
    "commissioned",
    "judge",
    "limit_for",
    "plant_figures",
    "read_history",
]
