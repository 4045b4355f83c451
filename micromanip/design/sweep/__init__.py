"""Thousands of drawn tunings over recordings: which would have held the path best."""

from .running import run_trials
from .space import Dimension, Space
from .store import Store
from .trial import Tried, Work

__all__ = ["Dimension", "Space", "Store", "Tried", "Work", "run_trials"]
