"""A recorded run again: the very same compiled cycle on what its rows say came in."""

from .self_replay import Difference, ReplayResult, replay

__all__ = ["Difference", "ReplayResult", "replay"]
